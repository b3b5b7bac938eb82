"""Branches of a spring's cycles on the contact of a specification."""

from typing import Final, NamedTuple

import numpy as np

from kernel.branches.any_contact import CycleBranch, branches, event_record, record
from kernel.branches.events import Events
from kernel.branches.follow import RANGE
from worker.spec.contact_models import Contact
from worker.sweep import SweepSpec
from worker.work import plate_of

#: Flights that count are longer, rad.
MICRO_FLIGHT: Final[float] = SweepSpec.model_fields["micro_flight"].default

#: Core-seconds of a cycle on its way, most of all of those with many hops.
CYCLE_SECONDS: Final = 2e-3


class Cycles(NamedTuple):
    """The branches from the cycles (1, periods), and the events on all of them."""

    branches: tuple[CycleBranch, ...]
    events: Events


def follow_cycles(
    contact: Contact, omega: float, xi: float, periods: int, gamma_max: float, points: int
) -> Cycles:
    """The branches up to `gamma_max`, at most `points` each way; runs on workers, which compile for it.

    Raises KernelInputError.
    """
    plate = plate_of(contact, np.full(1, gamma_max), np.full(1, omega), np.full(1, xi))
    followed = branches(plate, omega, xi, periods, span=(RANGE[0], gamma_max), points=points)
    events = [event for line in followed for event in line.events]
    return Cycles(
        tuple(record(line.points, MICRO_FLIGHT) for line in followed), event_record(events, MICRO_FLIGHT)
    )
