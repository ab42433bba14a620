"""Makes sure that the system has what pip cannot install: Python's venv and the libraries open3d links to.

Runs on the system's Python before anything is installed. What is missing is installed with apt-get where that is
allowed (root, or sudo without a password); otherwise one sentence says what to install.
"""

import ctypes
import importlib.util
import os
import shutil
import subprocess
import sys

# Debian package -> library that open3d's own shared object asks for, and that no wheel brings.
LIBRARIES = {
    "libegl1": "libEGL.so.1",
    "libgl1": "libGL.so.1",
    "libgomp1": "libgomp.so.1",
    "libidn2-0": "libidn2.so.0",
    "libudev1": "libudev.so.1",
    "libusb-1.0-0": "libusb-1.0.so.0",
    "libx11-6": "libX11.so.6",
}


def missing_packages():
    """Debian packages that are not there, by trying what they would give."""
    modules = ("venv", "ensurepip")
    packages = [] if all(map(importlib.util.find_spec, modules)) else ["python3-venv"]
    if sys.platform == "linux":
        packages += [package for package, library in LIBRARIES.items() if not loads(library)]
    return packages


def loads(library):
    """Whether the dynamic linker finds a library."""
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def apt_get():
    """The command that may install packages here, or None."""
    if shutil.which("apt-get") is None:
        return None
    if os.geteuid() == 0:
        return ["apt-get"]
    if shutil.which("sudo") and subprocess.run(["sudo", "-n", "true"], capture_output=True).returncode == 0:
        return ["sudo", "-n", "apt-get"]
    return None


def install(command, packages):
    """Installs packages, with a fresh package list only where the present one does not know them."""
    arguments = [*command, "install", "-qq", "-y", "--no-install-recommends", *packages]
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    print(f"Installing {', '.join(packages)} with apt-get.", flush=True)
    if subprocess.run(arguments, env=environment, capture_output=True).returncode == 0:
        return
    subprocess.run([*command, "update", "-qq"], env=environment, capture_output=True)
    result = subprocess.run(arguments, env=environment, capture_output=True, text=True)
    if result.returncode:
        sys.exit(f"apt-get could not install {', '.join(packages)}: {result.stderr.strip()}")


def main():
    """Checks Python's version, then installs or names what is missing."""
    if sys.version_info < (3, 11):  # noqa: UP036 - it runs before the package's own requirement is checked
        version = ".".join(map(str, sys.version_info[:3]))
        sys.exit(f"Expected Python 3.11 or newer, got {version}: install one and name it, make PYTHON=python3.11.")
    packages = missing_packages()
    if not packages:
        return
    command = apt_get()
    if command is not None:
        install(command, packages)
        packages = [name for name in missing_packages() if name in LIBRARIES]
    if packages:
        sys.exit(f"System packages are missing; install them with: apt-get install {' '.join(packages)}")


if __name__ == "__main__":
    main()
