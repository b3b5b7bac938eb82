"""The sweeps behind each figure of the paper.

The paper's own contact is soft (Eqs. 9-12), its restitution set "as closest as possible to zero". Eq. 12
holds for the adhesive law, under which the exact solution reaches zero itself: no small hops after a landing,
which time steps cannot avoid. The contact's depth follows from a rest length that the paper does not state;
1e-3 plate amplitudes is taken, which makes the flights of Fig. 2's modes 2e-3 rad shorter than a rigid plate.

"Every diagrams presented before are acquired for increased value of Γ or Ω", the paper says of Figs. 2 to 8:
they are ramped up here too, except Fig. 2, whose (1, 2) mode only a start from rest finds at Γ = 3.6.
"""

from collections.abc import Mapping
from typing import Any, Final, TypeAlias

Sweep: TypeAlias = Mapping[str, Any]

SOFT: Final[Sweep] = {"kind": "soft", "restitution": 0.0, "penetration": 1e-3, "adhesive": True}
RIGID: Final[Sweep] = {"kind": "rigid"}

#: ξ/Ω of Figs. 3 and 4.
RIGIDITY: Final = 650.0
#: A contact shallow enough to be harder than a spring of that rigidity.
SHALLOW: Final[Sweep] = {**SOFT, "penetration": 1e-6}

#: Fig. 2: Γ of the insets and the modes the paper names, (bounces, plate periods); None is chaotic.
INSETS: Final[Mapping[float, tuple[int, int] | None]] = {1.5: (1, 1), 2.3: (2, 2), 3.6: (1, 2), 5.0: None}

#: Fig. 5: the dampings.
DAMPINGS: Final = (0.01, 0.05, 0.2, 1.0)

#: Figs. 6 to 8: the sections through the diagram of ξ = 0.05.
XI: Final = 0.05
OMEGAS: Final = (0.67, 1.0, 1.24)
GAMMAS: Final = (1.0, 2.0, 3.0)

#: Fig. 7b: where the paper sees chaos, and where this looks for it, with contacts of all kinds.
DOUBTED: Final[Sweep] = {"start": 1.8, "stop": 2.2, "num": 81}
CONTACTS: Final[Mapping[str, Sweep]] = {
    "e = 0.05": {**SOFT, "restitution": 0.05},
    "e = 0.1, never pulling": {**SOFT, "restitution": 0.1, "adhesive": False},
    "e = 0, ten times deeper": {**SOFT, "penetration": 1e-2},
    "an ideal plate": RIGID,
}
#: Plate periods that are long for settling, and short.
SETTLED: Final = 1000
HARDLY: Final = 20
#: Rebounds far from the paper's, with which there is chaos.
ELASTIC: Final = (0.25, 0.5)

#: Hops too small to be seen in a diagram, rad: not counted in modes.
UNSEEN: Final = 0.01


def _up(axis: str, direction: str = "up") -> Sweep:
    return {"kind": "ramp", "axis": axis, "direction": direction}


def _line(start: float, stop: float, num: int, spacing: str = "linear") -> Sweep:
    return {"start": start, "stop": stop, "num": num, "spacing": spacing}


def figure_2() -> tuple[Sweep, ...]:
    """From rest, as the insets need it; and the same ramped up."""
    sweep = {"name": "figure 2", "gamma": _line(1.0, 6.0, 1001), "omega": 0.5, "xi": 0.26, "model": SOFT}
    return (
        {**sweep, "protocol": {"kind": "rest"}},
        {**sweep, "name": "figure 2, ramped up", "protocol": _up("gamma")},
    )


def figure_3() -> tuple[Sweep, ...]:
    """Spring and ball; then the spring on a contact as deep as the other figures', fewer cells."""
    spring, ball = _spring_and_ball(3, xi=10.0, restitution=0.0)
    deep = {**spring, "name": "figure 3, deep contact", "gamma": _line(1.0, 7.0, 151), "model": SOFT}
    return spring, ball, deep


def figure_4() -> tuple[Sweep, ...]:
    """Spring and ball; then the ball with the spring's own restitution f(ξ) instead of 0.15."""
    spring, ball = _spring_and_ball(4, xi=0.5, restitution=0.15)
    own = {**ball, "name": "figure 4, ball of f(ξ)", "model": {"kind": "ball"}}
    return spring, ball, own


def _spring_and_ball(number: int, *, xi: float, restitution: float) -> tuple[Sweep, Sweep]:
    sweep = {
        "gamma": _line(1.0, 7.0, 601), "omega": xi / RIGIDITY, "xi": xi, "protocol": _up("gamma"),
        "micro_flight": UNSEEN,
    }  # fmt: skip
    spring = {**sweep, "name": f"figure {number}, spring", "model": SHALLOW}
    return spring, {
        **sweep,
        "name": f"figure {number}, ball",
        "model": {"kind": "ball", "restitution": restitution},
    }


def figure_5() -> tuple[Sweep, ...]:
    """Ramps up in steps of 0.5 %, so small that the steps themselves make no spring take off."""
    return (
        {
            "name": "figure 5", "gamma": _line(0.03, 4.0, 981, "log"), "omega": _line(0.1, 2.0, 39),
            "xi": list(DAMPINGS), "protocol": _up("gamma"), "model": RIGID,
            "settle": 100, "observe": 20, "keep": 1,
        },
    )  # fmt: skip


def figure_6() -> tuple[Sweep, ...]:
    """Where bouncing begins at the three Ω of Fig. 7."""
    sweep = figure_5()[0]
    return ({**sweep, "name": "figure 6", "omega": list(OMEGAS), "xi": XI},)


def figure_7() -> tuple[Sweep, ...]:
    """The three diagrams; then around Γ = 2 at Ω = 1: settled long and hardly, and on other contacts."""
    sections = {
        "name": "figure 7", "gamma": _line(0.01, 6.0, 600), "omega": list(OMEGAS), "xi": XI,
        "protocol": _up("gamma"), "model": SOFT, "settle": 300, "observe": 100,
    }  # fmt: skip
    doubted = {**sections, "gamma": DOUBTED, "omega": 1.0, "protocol": {"kind": "rest"}, "settle": SETTLED}
    contacts = (SOFT, *CONTACTS.values(), *({**SOFT, "restitution": e} for e in ELASTIC))
    return (
        sections,
        {**doubted, "name": "figure 7, hardly settled", "settle": HARDLY},
        *({**doubted, "name": f"figure 7, contact {i}", "model": model} for i, model in enumerate(contacts)),
    )


def figure_8() -> tuple[Sweep, ...]:
    """The three diagrams, ramped up along Ω."""
    return (
        {
            "name": "figure 8", "gamma": list(GAMMAS), "omega": _line(0.05, 2.0, 781), "xi": XI,
            "protocol": _up("omega"), "model": SOFT, "settle": 300, "observe": 100,
        },
    )  # fmt: skip


def figure_9() -> tuple[Sweep, ...]:
    """Both ramps; then down again from less high, at some Ω."""
    sweep = {
        "name": "figure 9", "gamma": _line(0.1, 3.0, 726), "omega": _line(0.1, 1.4, 131), "xi": XI,
        "protocol": _up("gamma", "both"), "model": RIGID, "settle": 100, "observe": 20, "keep": 1,
    }  # fmt: skip
    lower = {
        **sweep, "name": "figure 9, from less high", "gamma": _line(0.1, 1.2, 276),
        "omega": _line(0.2, 0.8, 31), "protocol": _up("gamma", "down"),
    }  # fmt: skip
    return sweep, lower
