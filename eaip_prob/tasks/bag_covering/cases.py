"""Trials to be run: which object stands where, who covers it, and what is perceived; all from a seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eaip_prob.simulation import AbstractObject, Workspace
from eaip_prob.tasks.bag_covering.motion import CUE, Covering, planned
from eaip_prob.tasks.bag_covering.people import TRAINING, Partner
from eaip_prob.tasks.bag_covering.site import Site, drawn_site


@dataclass(frozen=True, eq=False)
class Case:
    """One trial before anybody sees it.

    Args:
        partner: who covers.
        site: the object in its place.
        motion: of the partner, and of the left gripper as a demonstrator would lead it.
        seed: of perception.
    """

    partner: Partner
    site: Site
    motion: Covering
    seed: int

    @property
    def name(self) -> str:
        """Object and partner."""
        return f"{self.site.name}, {self.partner.name}"


@dataclass(frozen=True, eq=False)
class Room:
    """Objects, their classes and the room in which they are put.

    Args:
        things: name -> object.
        labels: name -> class.
        workspace: the room.
    """

    things: Mapping[str, AbstractObject]
    labels: Mapping[str, str]
    workspace: Workspace

    def cases(
        self, names: Sequence[str], population: str, num_partners: int, seed: int, cue: float = CUE
    ) -> list[Case]:
        """Each partner of a population covers each object once, in places of their own.

        A case does not depend on which other objects and partners there are, and its place and draws not on the cue.

        Args:
            names: of the objects.
            population: of the partners, "training" or "test".
            num_partners: number of partners.
            seed: of everything drawn.
            cue: share of aim in the first phase of the motion.

        Raises:
            InputError: an unknown object or population.
        """
        found = []
        order = sorted(self.things)
        for number in range(num_partners):
            person = [seed, number, int(population == TRAINING)]
            partner = Partner.drawn(population, number, np.random.default_rng(person))
            shown = replace(self.workspace, person=replace(self.workspace.person, stature=partner.stature))
            for name in names:
                index = order.index(name) if name in order else len(order)
                draw = np.random.default_rng([*person, index])
                site = drawn_site(name, self.things, self.labels, shown, draw)
                found.append(Case(partner, site, planned(site, partner, draw, cue), int(draw.integers(2**31))))
        return found
