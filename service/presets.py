"""Preset sweeps: the sweeps behind each figure of the paper.

The paper's contact is soft (Eqs. 9-12), with a restitution set "as closest as possible to zero". Eq. 12 holds
for the adhesive law, under which the exact solution allows e = 0: there are no small hops after a landing,
which time steps cannot avoid. The penetration depends on a rest length that the paper does not state. The
presets use 1e-3 plate amplitudes, which makes the flights of Fig. 2's modes 2e-3 rad shorter than on a rigid
plate.

"Every diagrams presented before are acquired for increased value of Γ or Ω", the paper says of Figs. 2 to 8.
The presets ramp up too, except in Fig. 2: at Γ = 3.6 only a start from rest reaches its (1, 2) mode.

Where the paper says what is chaotic, in Figs. 7 and 8, the largest Lyapunov exponent is computed too.

Light to import: the service lists `FIGURES` for the page, `service.figures` draws them.
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple, TypeAlias

Sweep: TypeAlias = Mapping[str, Any]

SOFT: Final[Sweep] = {"kind": "soft", "restitution": 0.0, "penetration": 1e-3, "adhesive": True}
RIGID: Final[Sweep] = {"kind": "rigid"}

#: ξ/Ω of Figs. 3 and 4.
RIGIDITY: Final = 650.0
#: A contact shallow enough to be stiffer than a spring of that rigidity.
SHALLOW_SOFT: Final[Sweep] = {**SOFT, "penetration": 1e-6}

#: Fig. 2: Γ of the insets and the modes the paper reports, (bounces, plate periods); None is chaotic.
INSETS: Final[Mapping[float, tuple[int, int] | None]] = {1.5: (1, 1), 2.3: (2, 2), 3.6: (1, 2), 5.0: None}

#: Fig. 5: the dampings.
DAMPINGS: Final = (0.01, 0.05, 0.2, 1.0)

#: Figs. 6 to 8: the sections through the diagram of ξ = 0.05.
XI: Final = 0.05
OMEGAS: Final = (0.67, 1.0, 1.24)
GAMMAS: Final = (1.0, 2.0, 3.0)

#: Fig. 7b: the values of Γ where the paper reports chaos, computed here with several contacts.
GAMMA_NEAR_TWO: Final[Sweep] = {"start": 1.8, "stop": 2.2, "num": 81}
CONTACTS: Final[Mapping[str, Sweep]] = {
    "e = 0.05": {**SOFT, "restitution": 0.05},
    "e = 0.1, never pulling": {**SOFT, "restitution": 0.1, "adhesive": False},
    "e = 0, ten times deeper": {**SOFT, "penetration": 1e-2},
    "an ideal plate": RIGID,
}
#: Settling times, in plate periods: ample and too short.
LONG_SETTLE: Final = 1000
SHORT_SETTLE: Final = 20
#: Restitutions far above the paper's, at which the same values of Γ are chaotic.
ELASTIC: Final = (0.25, 0.5)
#: The simplest time steps of the paper's length (Eq. 13), which scatter the flights at the same values of Γ.
PLAIN_STEPS: Final[Sweep] = {
    **SOFT, "kind": "stepped", "restitution": 1e-6, "scheme": "euler", "events": "plain",
}  # fmt: skip

#: rad; flights shorter than this are invisible in a diagram and do not count in modes.
MICRO_FLIGHT: Final = 0.01


class FigurePreset(NamedTuple):
    """A figure of the paper: its number, its title and the sweeps it is drawn from."""

    number: int
    title: str
    sweeps: tuple[Sweep, ...]  # the first is the one that the figure shows


def _ramp(axis: str, direction: str = "up") -> Sweep:
    return {"kind": "ramp", "axis": axis, "direction": direction}


def _axis(start: float, stop: float, num: int, spacing: str = "linear") -> Sweep:
    return {"start": start, "stop": stop, "num": num, "spacing": spacing}


def _figure_2() -> tuple[Sweep, ...]:
    """From rest, as the insets need it; then the same ramped up."""
    sweep = {"name": "figure 2", "gamma": _axis(1.0, 6.0, 1001), "omega": 0.5, "xi": 0.26, "model": SOFT}
    return (
        {**sweep, "protocol": {"kind": "rest"}},
        {**sweep, "name": "figure 2, ramped up", "protocol": _ramp("gamma")},
    )


def _figure_3() -> tuple[Sweep, ...]:
    """Spring and ball; then the spring with the penetration of the other figures, on fewer cells."""
    spring, ball = _spring_and_ball(3, xi=10.0, restitution=0.0)
    deep = {**spring, "name": "figure 3, deep contact", "gamma": _axis(1.0, 7.0, 151), "model": SOFT}
    return spring, ball, deep


def _figure_4() -> tuple[Sweep, ...]:
    """Spring and ball; then the ball with the restitution f(ξ) of the spring instead of 0.15."""
    spring, ball = _spring_and_ball(4, xi=0.5, restitution=0.15)
    return spring, ball, {**ball, "name": "figure 4, ball of f(ξ)", "model": {"kind": "ball"}}


def _spring_and_ball(number: int, *, xi: float, restitution: float) -> tuple[Sweep, Sweep]:
    sweep = {
        "gamma": _axis(1.0, 7.0, 601), "omega": xi / RIGIDITY, "xi": xi, "protocol": _ramp("gamma"),
        "micro_flight": MICRO_FLIGHT,
    }  # fmt: skip
    spring = {**sweep, "name": f"figure {number}, spring", "model": SHALLOW_SOFT}
    ball = {**sweep, "name": f"figure {number}, ball", "model": {"kind": "ball", "restitution": restitution}}
    return spring, ball


def _figure_5() -> tuple[Sweep, ...]:
    """Ramps up in steps of 0.5 %, too small to make a spring take off by themselves.

    Close to the threshold a spring of low damping settles slowly; until it has settled it decides none.
    """
    return (
        {
            "name": "figure 5", "gamma": _axis(0.03, 4.0, 981, "log"), "omega": _axis(0.1, 2.0, 39),
            "xi": list(DAMPINGS), "protocol": _ramp("gamma"), "model": RIGID, "observe": 20,
            "keep": 1,
        },
    )  # fmt: skip


def _figure_6() -> tuple[Sweep, ...]:
    """The threshold at the three Ω of Fig. 7."""
    sweep = _figure_5()[0]
    return ({**sweep, "name": "figure 6", "omega": list(OMEGAS), "xi": XI},)


def _figure_7() -> tuple[Sweep, ...]:
    """The three diagrams; then Γ around 2 at Ω = 1: short and long settling, other contacts, time steps."""
    sections = {
        "name": "figure 7", "gamma": _axis(0.01, 6.0, 600), "omega": list(OMEGAS), "xi": XI,
        "protocol": _ramp("gamma"), "model": SOFT, "settle": 300, "observe": 100, "exponents": 1,
    }  # fmt: skip
    at_rest = {"protocol": {"kind": "rest"}, "settle": LONG_SETTLE}
    near_two = {**sections, "gamma": GAMMA_NEAR_TWO, "omega": 1.0, **at_rest}
    elastic = {f"e = {e:g}": {**SOFT, "restitution": e} for e in ELASTIC}
    contacts = {"the contact of the figure": SOFT, **CONTACTS, **elastic}
    return (
        sections,
        {**near_two, "name": "figure 7, hardly settled", "settle": SHORT_SETTLE},
        *({**near_two, "name": f"figure 7, {words}", "model": model} for words, model in contacts.items()),
        {**near_two, "name": "figure 7, plain time steps", "model": PLAIN_STEPS, "exponents": 0},
    )


def _figure_8() -> tuple[Sweep, ...]:
    """The three diagrams, ramped up along Ω."""
    return (
        {
            "name": "figure 8", "gamma": list(GAMMAS), "omega": _axis(0.05, 2.0, 781), "xi": XI,
            "protocol": _ramp("omega"), "model": SOFT, "settle": 300, "observe": 100, "exponents": 1,
        },
    )  # fmt: skip


def _figure_9() -> tuple[Sweep, ...]:
    """Both ramps; then a ramp down from a lower Γ, at some Ω."""
    sweep = {
        "name": "figure 9", "gamma": _axis(0.1, 3.0, 726), "omega": _axis(0.1, 1.4, 131), "xi": XI,
        "protocol": _ramp("gamma", "both"), "model": RIGID, "observe": 20, "keep": 1,
    }  # fmt: skip
    lower = {
        **sweep, "name": "figure 9, from less high", "gamma": _axis(0.1, 1.2, 276),
        "omega": _axis(0.2, 0.8, 31), "protocol": _ramp("gamma", "down"),
    }  # fmt: skip
    return sweep, lower


#: In the order of their numbers. Fig. 1 is a schematic and needs no sweep.
FIGURES: Final[tuple[FigurePreset, ...]] = (
    FigurePreset(1, "the two models", ()),
    FigurePreset(2, "bifurcation diagram and motion at Ω = 0.5, ξ = 0.26", _figure_2()),
    FigurePreset(3, "rigid spring and inelastic ball", _figure_3()),
    FigurePreset(4, "rigid spring of low viscosity and partially elastic ball", _figure_4()),
    FigurePreset(5, "bouncing threshold at four dampings", _figure_5()),
    FigurePreset(6, "threshold at ξ = 0.05 and the sections of Figs. 7 and 8", _figure_6()),
    FigurePreset(7, "flight times against Γ at three Ω", _figure_7()),
    FigurePreset(8, "flight times against Ω at three Γ", _figure_8()),
    FigurePreset(9, "thresholds up and down", _figure_9()),
)
