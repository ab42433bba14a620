"""The packages: all of eaip_prob, and conf/ as eaip_prob.conf, which pyproject.toml cannot say together."""

from setuptools import find_packages, setup

setup(packages=[*find_packages(include=["eaip_prob", "eaip_prob.*"]), "eaip_prob.conf"])
