"""The rigid spring with diffrax: Dopri8 with events; JAX compiles a whole cell as one loop over phases."""

from functools import partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix

from benchmarks.phases import LIFT

jax.config.update("jax_enable_x64", True)

_STEPS = 100_000
_MOST_FLIGHTS = 2_000
#: Tolerance of an event's function: rounding of the phase after 200 periods allows no smaller one.
_ROOT = 1e-11


class Spring:
    """The compiled solver, for single cells and for batches."""

    def __init__(self, rtol: float) -> None:
        self._cell = jax.jit(partial(_flights, rtol))
        self._batch = jax.jit(jax.vmap(partial(_flights, rtol), in_axes=(0, None, None, None)))

    def run(self, gamma: float, omega: float, xi: float, periods: int) -> list[float]:
        """Flight times (rad) of a cell from rest."""
        flights, count = self._cell(gamma, omega, xi, periods)
        return np.asarray(flights)[: int(count)].tolist()

    def run_batch(self, gamma: np.ndarray, omega: float, xi: float, periods: int) -> np.ndarray:
        """Flight times (rad) of n cells at once, (n, _MOST_FLIGHTS)."""
        return np.asarray(self._batch(gamma, omega, xi, periods)[0])


def _flights(rtol: float, gamma: Any, omega: Any, xi: Any, periods: Any) -> Any:
    """Flight times and their number; equations as in benchmarks.phases."""
    gravity, dashpot, stiffness = 1.0 / gamma, 2.0 * xi / omega, 1.0 / omega**2
    end = 2.0 * jnp.pi * periods

    def force(q: Any, v: Any) -> Any:
        return dashpot * v + stiffness * q

    def stuck(t: Any, y: Any, _: Any) -> Any:
        return jnp.stack([y[1], jnp.cos(t) - gravity - force(y[0], y[1]), 0.0, 0.0])

    def normal(t: Any, y: Any, *_: Any, **__: Any) -> Any:
        return gravity - jnp.cos(t) - force(y[0], y[1])

    def flight(t: Any, y: Any, _: Any) -> Any:
        pull = force(y[0], y[1])
        return jnp.stack([y[1], -2.0 * pull, y[3], pull - gravity + jnp.cos(t)])

    def gap(t: Any, y: Any, *_: Any, **__: Any) -> Any:
        return y[2]

    def solve(slope: Any, event: Any, t: Any, y: Any) -> Any:
        """The time and state at the event, or at the end."""
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(slope), diffrax.Dopri8(), t, end, None, y, max_steps=_STEPS,
            stepsize_controller=diffrax.PIDController(rtol=rtol, atol=1e-3 * rtol),
            event=diffrax.Event(event, optimistix.Bisection(1e-15, _ROOT, flip=True), direction=False),
        )  # fmt: skip
        return solution.ts[0], solution.ys[0]

    def stick(carry: Any) -> Any:
        t, y, flights, count, _ = carry
        t, y = solve(stuck, normal, t, y)
        return t, y, flights, count, True

    def fly(carry: Any) -> Any:
        t, y, flights, count, _ = carry
        landed, y = solve(flight, gap, t + LIFT, _lifted(force, gravity, t, y))
        v = y[1] + y[3]
        over = landed < end
        flights = flights.at[count].set(jnp.where(over, landed - t, jnp.nan), mode="drop")
        flying = gravity - jnp.cos(landed) - force(y[0], v) < 0.0
        return landed, jnp.stack([y[0], v, 0.0, 0.0]), flights, count + over, flying

    flights = jnp.full(_MOST_FLIGHTS, jnp.nan)
    y = jnp.stack([-gravity / stiffness, 0.0, 0.0, 0.0])
    start = (jnp.asarray(0.0), y, flights, jnp.asarray(0), 2.0 * gravity - 1.0 < 0.0)
    _, _, flights, count, _ = jax.lax.while_loop(
        lambda carry: carry[0] < end, lambda carry: jax.lax.cond(carry[4], fly, stick, carry), start
    )
    return flights, count


def _lifted(force: Any, gravity: Any, t: Any, y: Any) -> Any:
    """q, q', gap and gap' LIFT rad after a take-off, as benchmarks.phases.lifted."""
    sin, cos, h = jnp.sin(t), jnp.cos(t), LIFT
    q, v = y[0], y[1]
    q2 = -2.0 * force(q, v)
    q3 = -2.0 * force(v, q2)
    q4 = -2.0 * force(q2, q3)
    q5 = -2.0 * force(q3, q4)
    g2, g3, g4, g5 = cos - gravity - q2 / 2, -sin - q3 / 2, -cos - q4 / 2, sin - q5 / 2
    return jnp.stack([
        q + h * (v + h * (q2 / 2 + h * (q3 / 6 + h * (q4 / 24 + h * q5 / 120)))),
        v + h * (q2 + h * (q3 / 2 + h * (q4 / 6 + h * q5 / 24))),
        h * h * (g2 / 2 + h * (g3 / 6 + h * (g4 / 24 + h * g5 / 120))),
        h * (g2 + h * (g3 / 2 + h * (g4 / 6 + h * g5 / 24))),
    ])  # fmt: skip
