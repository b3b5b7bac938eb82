"""The specification: what it accepts, and for every rule the very line that a user reads."""

import json
import re

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter
from tables import for_each

from kernel.params import Cell
from worker.spec.axes import MAX_AXIS_VALUES, Range
from worker.spec.contact_models import CONTACT_MODELS, Rigid
from worker.spec.errors import SpecInvalid, SpecUnreadable
from worker.spec.refine import Refine
from worker.spec.specification import Label
from worker.studies import from_stored
from worker.sweep import SweepSpec
from worker.sweep.specification import EarlierSweep, no_cycle, start_of

POINT = {"gamma": 2.0, "omega": 0.5, "xi": 0.26}
FORMS = "a number, a list of numbers, or a range with start, stop, num and spacing"


def sweep(**changes) -> SweepSpec:
    return SweepSpec(**(POINT | changes))


def range_(start=1.0, stop=2.0, num=3, **more):
    return {"start": start, "stop": stop, "num": num, **more}


def ramp(axis="gamma", direction="up", **more):
    return {"kind": "ramp", "axis": axis, "direction": direction, **more}


#: A line whose lower end lies just above the fold of (1, 1).
SEEDED = {
    "gamma": range_(0.555, 0.6, 4),
    "omega": 0.6,
    "xi": 0.05,
    "model": {"kind": "rigid"},
    "protocol": ramp(direction="down", start={"periods": 1}),
}


def message(**changes) -> str:
    with pytest.raises(SpecInvalid) as caught:
        SweepSpec.parse(POINT | changes)
    return str(caught.value)


#: One row for each kind of rule, with the line that a user reads.
AXIS_RULES = [
    (True, f"gamma: must be {FORMS}, not true"),
    (float("nan"), "gamma: must be finite, not nan"),
    (10**400, "gamma: must be finite, not a whole number of about 400 digits"),
    (0, "gamma: must be at least 1e-06, not 0"),
    (1e9, "gamma: must be at most 1e+06, not 1e+09"),
    ([], "gamma: must hold at least one number"),
    ([1.0, "a"], "gamma[1]: must be a number, not text 'a'"),
    ([1.0, 1.0], "gamma: must increase, but 1.0 is followed by 1.0; sort and drop repeats"),
    ([1.0] * (MAX_AXIS_VALUES + 1), "gamma: must hold at most 100,000 numbers, not 100,001"),
    ({"start": 1.0}, "gamma.stop: is required\ngamma.num: is required"),
    (range_(num=2.5), "gamma.num: must be a whole number: 2 or 3, not 2.5"),
    (range_(num=0.5), "gamma.num: must be a whole number: 1, not 0.5"),
    (range_(num=-2.5), "gamma.num: must be a whole number, not -2.5"),
    (range_(num=10**5000), "gamma.num: must be at most 100,000, not a whole number of about 5000 digits"),
    (range_(start=2.0, stop=1.0), "gamma.start: must not be above stop: swap the two; "),
    (range_(start=1.0, stop=1.0, num=2), "gamma.num: must be 1 where start equals stop"),
    (range_(num=1), "gamma.num: must be at least 2 to reach from start to stop"),
    (range_(stop=1.0 + 1e-15, num=100), "gamma.num: must be small enough for distinct values: "),
    (
        range_(spacing="lin"),
        "gamma.spacing: must be 'linear' or 'log', not text 'lin'; did you mean 'linear'?",
    ),
    (range_(start=0.0, spacing="log"), "gamma.start: must be above 0 for spacing 'log', not 0; "),
    (
        range_(step=0.1),
        "gamma.step: is not a field here; did you mean 'num'? the fields are start, stop, num",
    ),
]

STEPPED = {"kind": "stepped", "penetration": 1e-4}
EULER = {"kind": "stepped", "scheme": "euler", "steps_per_contact": 2}

#: The same for the other fields: what the line begins with.
RULES = [
    ({"xi": -0.1}, "xi: must be at least 0, not -0.1"),
    ({"xi": [0.0, 1e-40, 1.0]}, "xi: must be 0 or at least 1e-30, not 1e-40"),
    ({"gama": 1}, "gama: is not a field here; did you mean 'gamma'? the fields are name, gamma, omega, xi"),
    ({"\ud800": 1}, "field names must be printable text, not text '\\ud800'"),
    ({"name": 3}, "name: must be text, not 3"),
    ({"name": "x" * 201}, "name: must have at most 200 characters, not 201"),
    ({"name": "two\nlines"}, "name: must be one line of printable characters"),
    ({"name": "a \u200d"}, "name: must be one line of printable characters"),
    ({"name": "a\u200d\u200db"}, "name: must be one line of printable characters"),
    ({"name": "\ud800"}, "name: must be text that UTF-8 can write, without lone surrogates"),
    ({"protocol": "ramp"}, "protocol: must be a group of fields, as {kind = \"ramp\"}, not text 'ramp'"),
    ({"Γ": 1}, "Γ: is not a field here; did you mean 'gamma'? "),
    ({"parent": "xyz"}, "parent: must be the id of a job, 32 hex digits, not text 'xyz'"),
    ({"protocol": {}}, "protocol.kind: is required: 'rest', 'ramp', 'orbits', 'basin' or 'multistability'"),
    ({"protocol": {"kind": "rest", "axis": "xi"}}, "protocol.axis: is not a field here; the fields are kind"),
    ({"protocol": {"kind": "ramp"}}, "protocol.axis: is required\nprotocol.direction: is required"),
    ({"protocol": ramp(), "omega": [0.5, 0.6]}, "protocol.axis: must name an axis of at least 2 values, "),
    ({"model": {"kind": "rigid", "penetration": 1e-3}}, "model.penetration: is not a field here; the fields"),
    ({"model": {"adhesive": 1}}, "model.adhesive: must be true or false, not 1"),
    ({"model": {"adhesive": False, "restitution": 0}}, "model.restitution: must be at least 1e-06 where "),
    ({"model": {"penetration": 1e-3, "rest_length": 1.0}}, "model.rest_length: must be left out where "),
    ({"model": {"rest_length": 1e9}}, "model.rest_length: gives contacts 1.25e+04 to 1.25e+04 plate "),
    ({"model": {"kind": "stepped", "restitution": 0}}, "model.restitution: must be at least 1e-06 for "),
    ({"model": {"kind": "stepped", "scheme": "rk4"}}, "model.scheme: must be 'verlet' or 'euler', not text "),
    ({"model": STEPPED | {"events": "late"}}, "model.events: must be 'located' or 'plain', not text 'late'"),
    ({"model": STEPPED | {"penetration": 1e-8}}, "model.penetration: asks for 2.25e+09 steps in a plate "),
    ({"model": STEPPED, "settle": 100_000}, "model.steps_per_contact: asks for 2.25e+05 steps in a plate "),
    (
        {"model": EULER, "omega": 0.1, "xi": [65.0, 70.0]},
        "model.steps_per_contact: must be at least 12, not 2: ",
    ),
    ({"model": {"kind": "auto", "tolerance": 0}}, "model.tolerance: must be at least 1e-09, not 0.0: "),
    ({"settle_tolerance": 1e-10}, "settle_tolerance: was removed; settle 'auto' ends a cell as soon as "),
    ({"settle_early": False}, "settle_early: was removed; settle 'auto' ends a cell as soon as its "),
    ({"settle_until": 399}, "settle_until: was removed; until, with settle 'auto', gives settling "),
    ({"until": 399}, "until: must be at least 200 + 2 × observe, 400, to have an effect; leave it "),
    ({"until": 5000, "settle": 100}, "until: must be left out where settle is 100: its windows are fixed; "),
    ({"settle": "long"}, "settle: must be 'auto' or a whole number of plate periods, not text 'long'"),
    (
        {"exponents": 4, "model": {"kind": "rigid"}},
        "exponents: must be at most 3 where model.kind is 'rigid' ",
    ),
    (
        {"exponents": 3, "model": {"kind": "ball"}},
        "exponents: must be at most 2 where model.kind is 'ball'; ",
    ),
    ({"settle": 1.5}, "settle: must be a whole number: 1 or 2, not 1.5"),
    ({"settle": True}, "settle: must be a whole number, not true"),
    ({"keep": 0}, "keep: must be at least 1, not 0"),
    ({"keep": "100"}, "keep: must be a whole number, not text '100'"),
    ({"protocol": {"kind": "basin"}}, "protocol.kind: 'basin' is a study of its own, not a sweep: "),
]


@for_each(("changes", "expected"), [({"gamma": gamma}, expected) for gamma, expected in AXIS_RULES] + RULES)
def test_rule_says(changes, expected):
    assert message(**changes).startswith(expected)


def test_unknown_model_names_the_ones_there_are():
    said = message(model={"kind": "rigit"})
    assert said.startswith("model.kind: must be ")
    assert said.endswith("not text 'rigit'; did you mean 'rigid'?")
    assert all(f"'{kind}'" in said for kind in CONTACT_MODELS)
    assert message(model={"kind": []}).endswith("not a list of 0")


def suggestion(said: str) -> int:
    """The number of steps a contact that a message says would work."""
    found = re.search(r"^model.steps_per_contact: .*(?:at least (\d+),|; (\d+) works$)", said)
    assert found, said
    return int(found[1] or found[2])


@settings(max_examples=50)
@given(
    e=st.floats(1e-6, 0.99), d=st.floats(1e-4, 0.3), omega=st.floats(0.01, 10.0), xi=st.floats(0.0, 1e3),
    adhesive=st.booleans(), scheme=st.sampled_from(["verlet", "euler"]),
)  # fmt: skip
def test_the_steps_a_refusal_suggests_are_the_fewest_that_work(e, d, omega, xi, adhesive, scheme):
    def refusal(steps) -> str:
        model = {"kind": "stepped", "restitution": e, "penetration": d, "adhesive": adhesive}
        try:
            sweep(omega=omega, xi=xi, model=model | {"scheme": scheme, "steps_per_contact": steps})
        except SpecInvalid as refused:
            return str(refused)
        return ""

    first = refusal(1)
    assume("unstable" in first)
    fewest = suggestion(first)
    assert f"must be at least {fewest}, not {fewest - 1}" in refusal(fewest - 1)
    assert "unstable" not in refusal(fewest)  # though it may take too many of them


@for_each(
    ("grid", "refused"),
    [({"gamma": [3.6, 4.1], "omega": [0.1, 7.0]}, 1e12), ({"gamma": [1.0, 3.0], "omega": 0.6}, 1e-9),
     ({"gamma": 1.0, "omega": 1e-5}, 1.0), ({"gamma": 1.0, "omega": 1.0}, 5e-324)],
)  # fmt: skip
def test_both_rest_lengths_that_a_refusal_names_work(grid, refused):
    said = message(**grid, model={"rest_length": refused})
    for end in re.findall(r"; (\S+) to (\S+) works$", said)[0]:
        assert sweep(**grid, model={"rest_length": float(end)})
    assert sweep(gamma=0.3, omega=1.0, model={"rest_length": 3000})  # of the largest depth, by rounding


def test_a_grid_of_depths_as_wide_as_the_limits_is_to_be_narrowed():
    said = message(gamma=[1e-6, 1e6], omega=0.5, model={"rest_length": 1e12})
    assert said.endswith("; narrow gamma or omega")


@given(
    st.floats(1e-6, 1e6), st.floats(1e-6, 1e6), st.integers(2, 300), st.sampled_from(["linear", "log"])
)  # fmt: skip
def test_any_accepted_range_increases(one, two, num, spacing):
    start, stop = sorted((one, two))
    assume(start * (1 + 1e-9) < stop)  # closer ones are refused, see above
    spec = sweep(gamma=range_(start, stop, num, spacing=spacing))
    values = spec.axis_values("gamma")
    assert values.dtype == np.float64
    assert len(values) == num
    assert np.all(np.diff(values) > 0)


@for_each(("changes", "expected"), [
    ({"protocol": ramp(start={"bounces": 2})}, "protocol.start.bounces: must be 1, not 2: "),
    ({"protocol": ramp(start=5)}, "protocol.start: must be a group of fields, not 5"),
    (
        {"omega": [0.6, 0.7]},
        "protocol.start: there is no stable cycle (1, 1) at gamma 0.6, omega 0.7, xi 0.05; there is "
        "one from gamma 0.669",
    ),
    ({"model": {"kind": "ball"}}, "protocol.start: needs a spring, and model.kind is 'ball'; "),
    ({"omega": range_(0.5, 1.0, 1001)}, "protocol.start: is possible for at most 1,000 lines, and "),
])  # fmt: skip
def test_a_start_on_a_cycle_that_cannot_be_is_refused(changes, expected):
    assert message(**(SEEDED | changes)).startswith(expected)


@for_each(("omega", "xi", "periods"), [(0.6, 0.05, 1), (0.949, 0.053, 1), (1.24, 0.05, 2)])
def test_a_refused_start_names_all_gamma_that_have_one(omega, xi, periods):
    def starts(gamma):
        return start_of(Cell(gamma, omega, xi), periods) is not None

    ranges = re.findall(r"([\d.]+) to ([\d.]+)", no_cycle(Cell(0.01, omega, xi), periods))
    assert ranges
    for low, high in np.array(ranges, float).tolist():
        assert starts(low)
        assert starts(high)
        assert not starts(low * (1.0 - 2e-6))
        assert not starts(high * (1.0 + 2e-6))


def test_a_start_is_part_of_the_identity_only_where_it_is_set():
    seeded = sweep(**SEEDED)
    assert seeded.canonical()["protocol"]["start"] == {"bounces": 1, "periods": 1}
    whole = sweep(**SEEDED | {"protocol": ramp(direction="down", start={"bounces": 1.0, "periods": 1})})
    assert whole.job_id("1") == seeded.job_id("1")
    plain = sweep(**SEEDED | {"protocol": ramp(direction="down")})
    off = sweep(**SEEDED | {"protocol": ramp(direction="down", start=None)})
    assert plain.job_id("1") == off.job_id("1") != seeded.job_id("1")
    assert plain.as_submitted()["protocol"] == ramp(direction="down")
    assert SweepSpec.parse(seeded.as_submitted()) == seeded


@pytest.mark.parametrize(("direction", "gamma"), [("down", 0.6), ("up", 0.555), ("both", 0.555)])
def test_a_line_begins_where_its_first_direction_does(direction, gamma):
    seeded = sweep(**SEEDED | {"protocol": ramp(direction=direction, start={})})
    assert [tuple(cell) for cell in seeded.first_cells()] == [(gamma, 0.6, 0.05)]
    grid = sweep(gamma=range_(), omega=[0.5, 0.6], xi=[0.0, 0.1], protocol=ramp("omega", direction))
    first = 0.6 if direction == "down" else 0.5
    expected = [(gamma, first, xi) for xi in (0.0, 0.1) for gamma in (1.0, 1.5, 2.0)]
    assert [tuple(cell) for cell in grid.first_cells()] == expected
    assert list(sweep().first_cells()) == []


def test_same_sweep_written_differently_is_the_same_job():
    one = sweep(gamma=range_(1.0, 2.0, 3), name="a", until=5000.0)
    two = sweep(gamma=[1, 1.5, 2], name="b", model={"penetration": 1e-3}, protocol={"kind": "rest"})
    assert sweep(settle=200).job_id("1") == sweep(settle=200.0, settle_early=True).job_id("1")
    assert one.job_id("1") == two.job_id("1")
    assert re.fullmatch("[0-9a-f]{32}", one.job_id("1"))
    assert sweep(xi=0).job_id("1") == sweep(xi=-0.0).job_id("1") == sweep(xi=[-0.0]).job_id("1")
    model, length = {"kind": "rigid"}, {"rest_length": 1.0}
    others = [{"gamma": 2.0000000000000004}, {"keep": 63}, {"settle": 200}, {"until": 8000}]
    for changes in (*others, {"model": model}, {"model": length}):
        assert sweep(**changes).job_id("1") != sweep().job_id("1")


def test_an_effort_is_its_fields():
    thorough = SweepSpec.parse(POINT | {"effort": "thorough"})
    assert thorough == sweep(observe=1000)
    assert "effort" not in thorough.as_submitted()
    assert sweep(effort="standard") == sweep()
    assert sweep(effort="draft").settles_until == 260
    assert message(effort="draft", observe=3) == "observe: is set by effort 'draft': leave out one of the two"
    expected = "effort: must be 'draft', 'standard' or 'thorough', not text 'fast'"
    assert message(effort="fast") == expected


def test_identity_is_not_forgotten_from_release_to_release():
    """If this fails, every stored job is computed anew: a thing to do on purpose only."""
    assert sweep(micro_flight=0.0, settle=200).job_id("1") == "07e4a0b73fc29560de65d362ac80685e"
    for model in (STEPPED, STEPPED | {"events": "located"}):
        assert sweep(model=model, settle=200).job_id("1") == "92361d912a9cc876b64adbb2df8ace86"
    assert sweep(model=STEPPED | {"events": "plain"}).job_id("1") != sweep(model=STEPPED).job_id("1")


PLAIN = {"model": {"kind": "stepped", "events": "plain"}}


@for_each(("changes", "certifies", "until"), [
    ({}, True, 5000),
    ({"model": {"kind": "rigid"}}, True, 5000),
    ({"model": {"kind": "auto"}}, True, 5000),
    ({"protocol": ramp(), "gamma": range_(), "until": 8000}, True, 8000),
    ({"model": {"kind": "ball"}, "observe": 10_000}, True, 10_200),  # no extension
    ({"settle": 200}, False, None),
    ({"exponents": 1}, False, 5000),
    (PLAIN, False, 5000),
])  # fmt: skip
def test_cells_are_certified_unless_windows_are_fixed_or_tangents_are_missing(changes, certifies, until):
    spec = sweep(**changes)
    assert (spec.certifies, spec.settles_until, spec.window[0]) == (certifies, until, 200)


def test_an_earlier_specification_keeps_its_id_and_is_computed_anew_with_certificates():
    fields = POINT | {"settle": 100, "observe": 20, "settle_until": 1920}
    stored = from_stored(json.dumps(EarlierSweep(**fields).as_submitted()))
    assert isinstance(stored, EarlierSweep)
    assert stored.job_id("8") == "d6fd92cfef6c87c354a569414af7fec9"
    assert EarlierSweep(**POINT).job_id("8") == sweep(settle=200).job_id("8")
    assert EarlierSweep(**POINT, settle_early=False).job_id("8") == "cd0cca3331677e544616eb949ad4a002"
    assert stored.today() == sweep(settle="auto", observe=20, until=1920)
    assert EarlierSweep(**POINT, settle_tolerance=1e-9).today() == sweep(settle=200)


def test_a_stored_map_with_a_margin_keeps_its_id_and_is_computed_anew_without():
    plane = {
        "gamma": {"start": 0.9, "stop": 6.0, "num": 101},
        "omega": {"start": 0.2, "stop": 1.2, "num": 101},
    }
    fields = plane | {"xi": 0.26, "settle": 200, "settle_until": 5000, "keep": 8}
    refine = {"by": "mode", "coarsest": 16}
    stored = from_stored(
        json.dumps(fields | {"model": {"kind": "rigid"}, "refine": {**refine, "margin": True}})
    )
    assert stored.job_id("7") == "854f970cffce97a404750f9882076137"
    assert stored.today().refine == Refine(by="mode", coarsest=8)
    assert EarlierSweep(**fields, refine=refine).today().refine == Refine(**refine)


def test_a_ball_that_is_given_no_restitution_has_its_springs():
    """docs/model.md, section 5: f(0.5) = 0.1492, f(10) = 0.0012."""
    cells = np.ones(2), np.ones(2), np.array([0.5, 10.0])
    own, given = (sweep(model={"kind": "ball", "restitution": e}).model for e in (None, 0.3))
    assert own.plate_arguments(*cells)["restitution"] == pytest.approx([0.1492, 0.0012], abs=5e-5)
    assert given.plate_arguments(*cells)["restitution"].tolist() == [0.3, 0.3]


@for_each(("name", "text", "fields"), [
    ("a.toml", "gamma = inf\nomega = 2020-01-01\nxi = 0.1\n", ["gamma", "omega"]),
    ("a.json", '{"gamma": 1e999, "omega": 1, "xi": 1}', ["gamma"]),
])  # fmt: skip
def test_infinities_words_and_dates_are_no_numbers(tmp_path, name, text, fields):
    (tmp_path / name).write_text(text)
    with pytest.raises(SpecInvalid) as caught:
        SweepSpec.from_file(tmp_path / name)
    assert [problem.field for problem in caught.value.problems] == fields


def test_an_object_of_a_specification_says_its_rules():
    with pytest.raises(SpecInvalid, match=r"^start: must not be above stop"):
        Range(start=3, stop=1, num=5)
    with pytest.raises(
        SpecInvalid, match=r"^penetration: is not a field here; the fields are kind, restitution"
    ):
        Rigid(penetration=1)


UNREADABLE = [
    (b"", "the text is empty"),
    (b'{"gamma": 0,4}', "the text is not JSON at line 1, column 13: a number has a decimal point, no comma"),
    (b'{"gamma": 1,}', "the text is not JSON at line 1, column 1"),
    (
        b"gamma = 1",
        "the text is not JSON at line 1, column 1; JSON begins with {; TOML is read by bounce submit",
    ),
    (b"\xff", "the text is not UTF-8 at byte 0"),
    (b'{"gamma": NaN}', "NaN is not a number in JSON; leave the value out or give a finite one"),
    (b'{"gamma": -Infinity}', "-Infinity is not a number in JSON"),
    (b'{"xi": 1, "xi": 2}', "field 'xi' is given twice; give it once"),
    (b'{"xi": ' + b"1" * 5000 + b"}", "a number of 5000 digits is too long; 400 is the most"),
    (b"[" * 100_000, "the JSON is nested too deeply; a specification needs two levels"),
]


@for_each(("text", "expected"), UNREADABLE)
def test_unreadable_text_says(text, expected):
    with pytest.raises(SpecUnreadable) as caught:
        SweepSpec.from_json(text)
    assert str(caught.value).startswith(expected)


@for_each(("name", "content", "expected"), [
    ("a.txt", b"", "a specification file ends in .json or .toml"),
    ("a.TOML", b"\xef\xbb\xbfgamma = 0,4", "TOML at line 1, column 10: a number has a decimal point, no "),
    ("a.toml", b"[model]\n[model]", "a field is given twice, at line 2; give it once"),
    ("a.toml", b"gamma = ", "the text is not TOML"),
    ("a.toml", b"\xff", "the text is not UTF-8 at byte 0"),
    ("a.toml", b" " * 1_000_001, "a TOML file must be at most 1,000,000 bytes; give long axes as "),
    ("a.json", b" " * 4_000_001, "must be at most 4,000,000 bytes; give long axes as ranges"),
])  # fmt: skip
def test_unreadable_file_says(tmp_path, name, content, expected):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SpecUnreadable) as caught:
        SweepSpec.from_file(tmp_path / name)
    assert expected in str(caught.value)


def test_a_pile_of_combining_marks_is_refused():
    fields, label = {"gamma": 1.0, "omega": 1.0, "xi": 0.5}, TypeAdapter(Label)
    joined = "\u0645\u06cc\u200c\u0631\u0648\u0645 \u0d28\u0d4d\u200d \U0001f468\u200d\U0001f467"
    for name in (
        "Vie\u0302\u0323t e\u0301\u0302\u0323\u0324",
        "\u0915\u094d\u0937\u093f",
        "s\u0336t\u0336",
        joined,
    ):
        assert label.validate_python(name) == name
    for name in (
        "e" + "\u0301" * 5,
        "\u0301" * 200,
        "ok \u20dd\u20dd\u20dd\u20dd\u20dd",
        "e" + "\u0301\u200d" * 5,
    ):
        with pytest.raises(SpecInvalid, match=r"^name: must have at most 4 combining marks in a row$"):
            SweepSpec(**fields, name=name)
