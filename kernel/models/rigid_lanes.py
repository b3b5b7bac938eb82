"""The contacts and flights of `rigid` in lanes (`kernel.models.lanes`)."""

from typing import Any

from kernel.cell import Progress
from kernel.interface import advance_lanes, load_lane, unload_lane
from kernel.models.lanes import (
    AT_ROOT,
    COS,
    COUNT,
    K0,
    K1,
    MOVE,
    SHORT_FLIGHT,
    SHORT_START,
    SIN,
    STATUS,
    TAU,
    Y1,
    Y,
    advance,
    coefficients,
    load,
    supports,
)
from kernel.models.rigid import RigidPlate, Spring, land
from kernel.numerics.first_root import HORIZON, ROOT, Phase, departure_step
from kernel.numerics.jit import inlined
from kernel.numerics.oscillator import decay_time, derivatives
from kernel.params import LANES
from kernel.portable_math import hypot


@advance_lanes.register(RigidPlate)
@inlined
def _advance(plate: RigidPlate, table: Any, used: int) -> None:
    """`lanes.advance`."""
    advance(table, used)


@inlined
def _load_contact(
    table: Any, k: int, s: Spring, run: Progress, sin: float, cos: float, horizon: float
) -> bool:
    """Put a contact into lane k, unless it never ends, which `rigid` knows in closed form.

    sin and cos are of the plate's phase now.
    """
    h = run.q - s.static_elongation - (s.q_re * cos - s.q_im * sin)
    h1 = run.q1 + (s.q_re * sin + s.q_im * cos)
    h2, h3, _ = derivatives(s.stuck, h, h1)
    decayed = decay_time(s.stuck, h2, h3, s.mean_force - hypot(s.n_re, s.n_im))
    if decayed == 0.0:
        return False
    load(table, k, s.stuck, run.phase, h, h1, 0.0, min(horizon, decayed))
    coefficients(table, k, -s.stiffness, -s.dashpot, s.mean_force, 0.0, 0.0, -s.n_re, s.n_im)
    return True


@inlined
def _load_flight(
    table: Any, k: int, s: Spring, run: Progress, sin: float, cos: float, horizon: float
) -> bool:
    """Put a flight into lane k, unless it begins with a short hop or too close to the plate."""
    q2, q3, q4 = derivatives(s.flight, run.q, run.q1)
    gap2, start = cos - s.gravity - 0.5 * q2, 0.0
    if run.gap == 0.0 and run.gap1 == 0.0:
        start = departure_step(max(gap2, 0.0), -sin - 0.5 * q3, 1.0 + 0.5 * q4)
        if start < SHORT_START:
            return False
    elif run.gap == 0.0 and 2.0 * run.gap1 < -gap2 * SHORT_FLIGHT:
        return False
    load(table, k, s.flight, run.phase, run.q, run.q1, start, horizon)
    coefficients(
        table, k, -0.5, 0.0, run.gap + (cos + 0.5 * run.q), run.gap1 + (0.5 * run.q1 - sin),
        0.5 * s.gravity, -1.0, 0.0,
    )  # fmt: skip
    return True


@load_lane.register(Spring)
@inlined
def _load(s: Spring, table: Any, k: int, run: Progress, sin: float, cos: float, horizon: float) -> bool:
    """Put the run's next phase into lane k, if lanes support its oscillators."""
    if run.in_flight:
        loaded = _load_flight(table, k, s, run, sin, cos, horizon)
    else:
        loaded = _load_contact(table, k, s, run, sin, cos, horizon)
    return loaded and supports(s.stuck) and supports(s.flight)


@unload_lane.register(Spring)
@inlined
def _unload(s: Spring, table: Any, k: int, run: Progress) -> tuple[Phase, float, float]:
    """The phase that ended in lane k, with sin and cos of the plate's phase at its end.

    The state at the zero follows from that at the last evaluation by Taylor series in the last step, MOVE,
    to the fourth order (y) and third (y'); MOVE is below first_root.NEAR, so that the rest is rounding.
    """
    sin, cos = table[SIN * LANES + k], table[COS * LANES + k]
    move = table[MOVE * LANES + k]
    tau = table[TAU * LANES + k] + move
    y, y1 = table[Y * LANES + k], table[Y1 * LANES + k]
    osc = s.flight if run.in_flight else s.stuck
    y2, y3, _ = derivatives(osc, y, y1)
    y4 = -2.0 * osc.damping * y3 - osc.stiffness * y2
    y += move * (y1 + 0.5 * move * (y2 + move * (1.0 / 3.0) * (y3 + 0.25 * move * y4)))
    y1 += move * (y2 + 0.5 * move * (y3 + move * (1.0 / 3.0) * y4))
    square = move * move
    sine, versine = move * (1.0 - square * (1.0 / 6.0)), square * (0.5 - square * (1.0 / 24.0))
    sin, cos = sin + cos * sine - sin * versine, cos - sin * sine - cos * versine
    ending = ROOT if table[STATUS * LANES + k] == AT_ROOT else HORIZON
    used = int(table[COUNT * LANES + k])
    if not run.in_flight:
        q = s.static_elongation + (s.q_re * cos - s.q_im * sin) + y
        q1 = y1 - (s.q_re * sin + s.q_im * cos)
        return Phase(tau, ending, ending == ROOT, 0.0, 0.0, q, q1, used), sin, cos
    drift = table[K1 * LANES + k]
    gap1 = sin + drift - s.gravity * tau - 0.5 * y1
    if ending != ROOT:
        gap = table[K0 * LANES + k] - cos + (drift - 0.5 * s.gravity * tau) * tau - 0.5 * y
        return Phase(tau, ending, True, gap, gap1, y, y1, used), sin, cos
    return land(s, sin, cos, tau, gap1, y, y1, used), sin, cos
