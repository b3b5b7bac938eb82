"""A method for each result. Made by service.views.client_methods: do not edit."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from service.formats import Methods, Progress, Results

if TYPE_CHECKING:
    import xarray


class ResultMethods(Methods):
    """A method for each result of a job."""

    RESULTS: ClassVar[Results] = {
        "diagram": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("flight_time",)),
        "modes": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("outcome",)),
        "difference": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("up_moved",)),
        "threshold": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("up_status",)),
        "orbits": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("points", "event_gamma", "skipped_gamma")),
        "basins": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("attractor_fraction",)),
        "multistability": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("cells",)),
        "trajectory": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("plate",)),
        "audit": (("json", "bin", "nc", "csv", "parquet"), ("share", "cell_stored")),
    }

    def diagram(
        self,
        along: Annotated[Literal["gamma", "omega", "xi"], "axis of the diagram"] = "gamma",
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: every direction of the sweep"] = None,
        min_flight: Annotated[float | None, "rad; shorter flights do not count, unless all of a cell are; default: micro_flight"] = None,
        every: Annotated[int, "return every n-th value only"] = 1,
        log: Annotated[Literal["none", "x", "y", "xy"] | None, "logarithmic axes of a picture; default: those of values in equal ratios"] = None,
        start: Annotated[float | None, "smallest value of the axis"] = None,
        stop: Annotated[float | None, "largest value of the axis"] = None,
        flight_start: Annotated[float | None, "rad, shortest flight shown"] = None,
        flight_stop: Annotated[float | None, "rad, longest flight shown"] = None,
        hide: Annotated[str | None, "classes left out: at_rest and other labels, cycles as 2-fewer, 2-equal, 2-more, longer; of a map by multiplier also multiplier-0.2 to multiplier-1"] = None,
        caption: Annotated[bool, "whether a picture says how it was computed"] = True,
        branches: Annotated[bool, "cycles, stable and unstable: along gamma of one bounce, up to three periods, else those that cells settled to; not in tables"] = False,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """The flights of the cells along an axis.

        A sweep ramped both ways has the dimension `direction`, unless one is selected. Flights up to
        `min_flight` are NaN and do not count for `outcome`, `bounces` and `periods`, unless a cell has no longer
        ones. Flights outside the window, and all flights of classes to `hide`, are NaN too.

        Returns a Dataset with the attribute `complete` and the variables `flight_time` (rad), `takeoff_phase`
        (rad), `flights`, `bounces`, `periods`, `flight_error` (rad), `multiplier`, `multiplier_angle` (rad),
        `lyapunov`, `lyapunov_error`, `computed`, `outcome`, `label`, `branch_bounces`, `branch_periods`,
        `branch_gamma`, `branch_omega`, `branch_xi`, `branch_flight_time` (rad), `branch_stable`,
        `branch_violations`. Waits up to `timeout` seconds for the workers, and shows `progress`. Raises
        BadRequest naming the parameter, TooLarge naming what fits.
        """
        return self.result("diagram", along=along, gamma=gamma, omega=omega, xi=xi, direction=direction, min_flight=min_flight, every=every, log=log, start=start, stop=stop, flight_start=flight_start, flight_stop=flight_stop, hide=hide, caption=caption, branches=branches, timeout=timeout, progress=progress)

    def modes(
        self,
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: every direction of the sweep"] = None,
        min_flight: Annotated[float | None, "rad; shorter flights do not count, unless all of a cell are; default: micro_flight"] = None,
        every: Annotated[int, "return every n-th value only"] = 1,
        log: Annotated[Literal["none", "x", "y", "xy"] | None, "logarithmic axes of a picture; default: those of values in equal ratios"] = None,
        hysteresis: Annotated[bool, "where up and down differ, if a sweep has both"] = False,
        color: Annotated[Literal["mode", "multiplier"], "multiplier: the margin of stability, of a sweep that certifies cells"] = "mode",
        hide: Annotated[str | None, "classes left out: at_rest and other labels, cycles as 2-fewer, 2-equal, 2-more, longer; of a map by multiplier also multiplier-0.2 to multiplier-1"] = None,
        gamma_start: float | None = None,
        gamma_stop: float | None = None,
        omega_start: float | None = None,
        omega_stop: float | None = None,
    ) -> "xarray.Dataset":
        """Outcome, bounces and plate periods of every cell.

        The cells are those of the plane at one ξ. A sweep ramped both ways has the dimension `direction`,
        unless one is selected. In an adaptive map `computed` marks the computed cells, the attribute
        `computed_share` is their share; others have the mode of their block, a neighbour's label and multiplier.
        With the color `multiplier` cells have their certificates, too. Cells of classes to `hide` are `missing`.

        Returns a Dataset with the attribute `complete` and the variables `bounces`, `periods`, `outcome`,
        `label`, `computed`, `lyapunov`, `lyapunov_error`, `flight_error` (rad), `multiplier`,
        `multiplier_angle` (rad), `hysteresis`. Raises BadRequest naming the parameter, TooLarge naming what
        fits.
        """
        return self.result("modes", xi=xi, direction=direction, min_flight=min_flight, every=every, log=log, hysteresis=hysteresis, color=color, hide=hide, gamma_start=gamma_start, gamma_stop=gamma_stop, omega_start=omega_start, omega_stop=omega_stop)

    def difference(
        self,
        other: Annotated[str, "id of the sweep that this one is compared with"],
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: the first direction of the sweep"] = None,
        every: Annotated[int, "return every n-th value only"] = 1,
    ) -> "xarray.Dataset":
        """Where the modes of two sweeps differ.

        Each cell of this sweep is compared with the nearest one of the `other`, if it is within its axes: by
        outcome and mode, and by label where both have exponents. Thresholds are compared at the Ω of both. The
        attribute `sentence` says in how many cells modes are the same, and by how much thresholds move at most.

        Returns a Dataset with the attribute `complete` and the variables `differs`, `bounces`, `periods`,
        `outcome`, `label`, `other_bounces`, `other_periods`, `other_outcome`, `other_label`, `up_moved`,
        `down_moved`. Raises BadRequest naming the parameter, TooLarge naming what fits.
        """
        return self.result("difference", other=other, xi=xi, direction=direction, every=every)

    def threshold(
        self,
        xi: float | None = None,
        tolerance: Annotated[float | None, "in Γ: refine the thresholds beyond the grid, from the sweep's stored states"] = None,
        predict: Annotated[Literal["none", "some", "all", "cells", "search"], "which thresholds are predicted, see above"] = "some",
        omega_start: float | None = None,
        omega_stop: float | None = None,
        gamma_start: Annotated[float | None, "of a picture: its lowest threshold"] = None,
        gamma_stop: Annotated[float | None, "of a picture: its highest threshold"] = None,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """Where bouncing begins and ends, per Ω.

        The answer is for one ξ, beside Eq. 25 and the closed form. `up` and `down` are values of the grid, or
        with a `tolerance` refined by workers. They are NaN unless their status is `found`:

        - `below the grid`: the lowest Γ bounces already
        - `above the grid`: every cell is at rest
        - `never bounces`: of `up`, every cell is at rest and Eq. 25 is above every Γ that a specification may
          have; of `down`, no cell of the ramp bounces
        - `not ramped`: the sweep does not have this direction
        - `not refined`: the grid holds the change, and refinement reached its limit
        - `missing`, `unresolved`, `diverged`, `settling`: the outcome of the cell that decides, the lowest that
          is not at rest

        `predicted_down` is the lowest Γ at which bouncing persists on the contact that the attribute
        `prediction` names; a descent ends there or earlier, on another cycle. Workers predict what takes longer
        than a second. By `predict` it is:

        - `none`: not predicted
        - `some`: in closed form, for up to 200 values of Ω
        - `all`: in closed form, for every Ω
        - `cells`: from cycles of the sweep's cells; on an ideal plate where the closed form is `unresolved`
        - `search`: searched for where branches of the sweep's contact do not decide

        Returns a Dataset with the attribute `complete` and the variables `analytic`, `up`, `down`,
        `predicted_jump`, `predicted_down`, `up_status`, `down_status`, `cause`, `reason`, `difference`. Waits
        up to `timeout` seconds for the workers, and shows `progress`. Raises BadRequest naming the parameter,
        TooLarge naming what fits.
        """
        return self.result("threshold", xi=xi, tolerance=tolerance, predict=predict, omega_start=omega_start, omega_stop=omega_stop, gamma_start=gamma_start, gamma_stop=gamma_stop, timeout=timeout, progress=progress)

    def orbits(
        self,
        omega: float | None = None,
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: all of the sweep"] = None,
        gamma_max: Annotated[float | None, "branches are cut above this Γ; default: 8, of a study of orbits its own"] = None,
        doubled: Annotated[bool, "branches of twice the period that begin at flips as well"] = False,
        along: Annotated[Literal["gamma", "omega", "xi"], "what varies on the branches"] = "gamma",
        gamma: float | None = None,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """Branches of the cycles that cells settled to.

        They run along an axis, on the cells' own contact, stable and unstable, with their events. A study of
        orbits stores them, along Γ; those of a sweep are followed by workers, within seconds once compiled.
        `flight_time` has all flights of a cycle that count, the longest first. `skipped` are the periodic cells
        from which no branch was followed. `doubled` adds up to 12 branches of twice the period to which no cell
        settled.

        Returns a Dataset with the attribute `complete` and the variables `gamma`, `takeoff_phase` (rad),
        `elongation` (plate amplitudes), `elongation_velocity` (plate amplitudes per rad), `impact_velocity`
        (plate amplitudes per rad), `multipliers`, `stable`, `violations`, `flights`, `cycle_state`,
        `flight_time` (rad), `branch_bounces`, `branch_periods`, `points`, `event_kind`, `event_gamma`,
        `event_omega`, `event_xi`, `event_bounces`, `event_periods`, `event_flight_time` (rad),
        `event_violations`, `event_multipliers`, `event_branch`, `skipped_gamma`, `skipped_bounces`,
        `skipped_periods`, `skipped_reason`. Waits up to `timeout` seconds for the workers, and shows
        `progress`. Raises BadRequest naming the parameter, TooLarge naming what fits.
        """
        return self.result("orbits", omega=omega, xi=xi, direction=direction, gamma_max=gamma_max, doubled=doubled, along=along, gamma=gamma, timeout=timeout, progress=progress)

    def basins(
        self,
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
    ) -> "xarray.Dataset":
        """The attractors of one cell, and their basins.

        Attractors are numbered from 1 by the share of the starts of the plane that reach them. A start without
        an attractor has the number 0.

        Returns a Dataset with the attribute `complete` and the variables `attractor_of_start`,
        `attractor_fraction`, `attractor_outcome`, `attractor_bounces`, `attractor_periods`,
        `attractor_longest_flight` (rad), `attractor_lifetime` (plate periods), `attractor_flight_time` (rad),
        `attractor_takeoff_phase` (rad), `attractor_state`, `attractor_lyapunov`, `attractor_lyapunov_error`,
        `attractor_count`, `undecided`, `basin_entropy`, `boundary_entropy`, `attractor_label`. Raises
        BadRequest naming the parameter, TooLarge naming what fits.
        """
        return self.result("basins", gamma=gamma, omega=omega, xi=xi)

    def multistability(
        self,
        xi: float | None = None,
        omega: Annotated[float | None, "the nearest line along gamma alone"] = None,
    ) -> "xarray.Dataset":
        """The attractors of every cell at one ξ.

        They are matched from cell to cell, with births, deaths and changes of mode as events. One attractor has
        one `id` in all cells; ids are numbered from 1 by the number of cells. `omega` selects the line along Γ
        nearest to it, with the flights of every attractor. The attribute `several` is the share of cells with two
        attractors or more, `several_by_drops` the same without attractors that no drop reaches.

        Returns a Dataset with the attribute `complete` and the variables `count`, `id`, `label`, `fraction`,
        `longest_flight` (rad), `flight_time` (rad), `attractor_label`, `cells`, `event_kind`,
        `event_attractor`, `event_omega`, `event_gamma_below`, `event_gamma_above`, `event_below`,
        `event_above`, `event_leads_to`. Raises BadRequest naming the parameter, TooLarge naming what fits.
        """
        return self.result("multistability", xi=xi, omega=omega)

    def trajectory(
        self,
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: the first direction of the sweep"] = None,
        attractor: Annotated[int | None, "of a job of basins or multistability: which attractor of the cell, from 1"] = None,
        periods: Annotated[int, "plate periods"] = 4,
        samples: Annotated[int, "per plate period"] = 200,
        prove: Annotated[bool, "the cycle that the cell is on, with a proof"] = False,
    ) -> "xarray.Dataset":
        """The motion of one cell of a job.

        The samples begin after it has settled from rest, on its certified cycle, where the ramp left it, or on
        one of its attractors. Lengths are in plate amplitudes; the attribute `rest_length` is that of the spring.
        Flights are those that start and end within the samples. Refused for a cell of a ramp that is not
        computed yet, or that is unresolved or diverged: its stored state is where the computation stopped.

        Returns a Dataset with the attribute `complete` and the variables `plate` (plate amplitudes), `z1`
        (plate amplitudes), `z2` (plate amplitudes), `velocity` (A omega), `force` (m A ω²), `in_flight`,
        `takeoff` (rad), `takeoff_phase` (rad), `flight_time` (rad), `cycle_bounces`, `cycle_periods`,
        `cycle_flight_time` (rad), `cycle_multipliers`, `cycle_stable`, `cycle_violations`,
        `energy_plate_contact` (m A² ω²), `energy_plate_impact` (m A² ω²), `energy_dashpot` (m A² ω²),
        `energy_impact` (m A² ω²), `energy_force` (m A ω), `energy_impulse` (m A ω), `energy_weight` (m A ω),
        `proof`, `proof_says`, `proven_flight_times` (rad). Raises BadRequest naming the parameter, TooLarge
        naming what fits.
        """
        return self.result("trajectory", gamma=gamma, omega=omega, xi=xi, direction=direction, attractor=attractor, periods=periods, samples=samples, prove=prove)

    def audit(
        self,
        cells: Annotated[int | None, "cells of each sample; default: 59 to 200, as many as cost a tenth of the sweep"] = None,
        followed: Annotated[int | None, "cells of a soft contact that a time stepper follows; default: up to ten"] = None,
        seed: Annotated[int, "of the random sample"] = 0,
        tolerance: Annotated[float | None, "rad: flights that deviate by more have changed; default: that of auto, else 0.001"] = None,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """How many cells a longer computation would change.

        Workers draw cells at random and compute them again: for `numerics` with the same contact, cell by cell,
        and windows ten times as long; for `model`, where the specification names a contact that the sweep
        approximates, with that one. On a ramp a cell starts again from the stored state of the cell before it.
        Cells that are certified within `tolerance` need no sample for `numerics`, which is drawn from the rest.
        `low` and `high` are exact bounds of the share of all cells, whatever it is; undecided cells count as
        right in one and as wrong in the other.

        The questions:

        - `rest`, `outcome`, `mode`: cells with another answer
        - `flights`: cells at rest or periodic whose flights deviate by more than `tolerance`
        - `distribution`: other cells whose quantiles of flights do, beyond their scatter; undecided with
          fewer than 16 flights, or where the sweep keeps only some of them, fewer than 32
        - `label`: cells with another label, in a sweep with exponents
        - `threshold`: thresholds on the grid with a cell that changes between rest and bouncing
        - `area`: points anywhere between the cells that are not what the nearest cell is
        - `integrator`: cells of a soft contact, at rest or periodic, that time steps, which share no closed
          form with the kernel, do not follow within `tolerance`

        Lists the cells that changed, also hard ones outside the samples: corners, and cells next to another
        mode.

        Returns a Dataset with the attribute `complete` and the variables `sampled`, `changed`, `undecided`,
        `share`, `low`, `high`, `largest` (rad), `covered`, `deviation` (rad), `outcomes`, `mode_stored`,
        `mode_reference`, `mode_cells`, `cell_set`, `cell_direction`, `cell_gamma`, `cell_omega`, `cell_xi`,
        `cell_stored`, `cell_reference`, `cell_deviation` (rad), `cell_undecided`, `cells`, `certified`. Waits
        up to `timeout` seconds for the workers, and shows `progress`. Raises BadRequest naming the parameter,
        TooLarge naming what fits.
        """
        return self.result("audit", cells=cells, followed=followed, seed=seed, tolerance=tolerance, timeout=timeout, progress=progress)


class SpringMethods(Methods):
    """A method for each result of a spring."""

    RESULTS: ClassVar[Results] = {
        "threshold": (("json", "bin", "nc"), ()),
        "thresholds": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("cause",)),
        "orbits": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("points", "event_gamma")),
        "curves": (("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"), ("gamma", "event_gamma")),
    }

    def threshold(
        self,
        omega: float,
        xi: float,
        delta: Annotated[float, "Γ below `down` with a lifetime"] = 1e-06,
        prove: Annotated[bool, "an upper bound of `down` with a proof"] = False,
        model: Annotated[Literal["rigid", "soft"] | None, "contact whose cycles are followed; default: the ideal plate in closed form"] = None,
        restitution: Annotated[float | None, "of the model"] = None,
        penetration: Annotated[float | None, "of a soft model, in plate amplitudes"] = None,
        adhesive: Annotated[bool, "whether a soft model pulls before take-off"] = True,
        search: Annotated[bool, "search for what bounces below, by workers, seconds to minutes a spring"] = False,
        effort: Annotated[float | None, "of a search: 100 to 10,000 starts each; default: 50"] = None,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """Where one spring begins and ceases to bounce.

        A rigid contact without restitution has a closed form; with a `model`, workers follow the contact's own
        cycles, in a second or two once compiled. `down` is the lowest Γ at which bouncing persists, by a rule
        that no search contradicts from ξ = 0.04 on. `cause` is `not searched` below that damping, and
        `unresolved` where the rule does not decide. A slow descent ends at `down` or earlier, with the cycle that
        it is on. Below a fold bouncing lives for `lifetime`; the energy balance is that of the cycle at the
        fold. A worker computes what takes longer than a second.

        With `search`, workers try many starts at 30 values of Γ, for seconds to minutes. They follow the cycles
        that transients pass by, and motions that survive, down to their ends. The lowest end is an upper bound
        at any damping; `missed` is the share of starts that a basin must have to be seen with 95 %.

        Returns a Dataset with the attribute `complete` and the variables `threshold`, `jump`, `down`,
        `cause`, `status`, `reason`, `missed`, `lifetime` (plate periods), `delta`, `plate_contact` (m A² ω²),
        `plate_impact` (m A² ω²), `dashpot` (m A² ω²), `impact` (m A² ω²), `force` (m A ω), `impulse` (m A ω),
        `weight` (m A ω), `gone`, `rotation`, `rotation_error`, `proof`, `proof_says`, `down_at_most`,
        `proven_flight_time` (rad). Waits up to `timeout` seconds for the workers, and shows `progress`.
        Raises BadRequest naming the parameter, TooLarge naming what fits.
        """
        return self.result("threshold", omega=omega, xi=xi, delta=delta, prove=prove, model=model, restitution=restitution, penetration=penetration, adhesive=adhesive, search=search, effort=effort, timeout=timeout, progress=progress)

    def thresholds(
        self,
        omega: Annotated[str | Sequence[float], "values, as 0.45,0.46, or start:stop:number"],
        xi: Annotated[str | Sequence[float], "values, as 0.45,0.46, or start:stop:number"],
        model: Annotated[Literal["rigid", "soft"] | None, "contact whose cycles are followed; default: the ideal plate in closed form"] = None,
        restitution: Annotated[float | None, "of the model"] = None,
        penetration: Annotated[float | None, "of a soft model, in plate amplitudes"] = None,
        adhesive: Annotated[bool, "whether a soft model pulls before take-off"] = True,
        search: Annotated[bool, "search for what bounces below, by workers, seconds to minutes a spring"] = False,
        effort: Annotated[float | None, "of a search: 100 to 10,000 starts each; default: 50"] = None,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """Where the springs of a grid of Ω and ξ begin and cease to bounce.

        Workers compute each as `threshold` of one spring. With `search`, `missed` is the share of all starts of
        a basin that the search of a spring sees with 95 %.

        Returns a Dataset with the attribute `complete` and the variables `threshold`, `jump`, `down`,
        `cause`, `status`, `reason`, `missed`, `gone`, `rotation`, `rotation_error`. Waits up to `timeout`
        seconds for the workers, and shows `progress`. Raises BadRequest naming the parameter, TooLarge naming
        what fits.
        """
        return self.result("thresholds", omega=omega, xi=xi, model=model, restitution=restitution, penetration=penetration, adhesive=adhesive, search=search, effort=effort, timeout=timeout, progress=progress)

    def orbits(
        self,
        omega: float,
        xi: float,
        modes: Annotated[str, "bounces-periods, as 1-1,1-2; cycles of one bounce"] = "1-1,1-2",
        gamma_max: Annotated[float | None, "branches along gamma are cut above this Γ; default: 8"] = None,
        points: Annotated[int, "points of a branch, about; with a `model`, at most, each way"] = 400,
        start: Annotated[float | None, "lowest Γ of a window with `points` more"] = None,
        stop: Annotated[float | None, "highest Γ of the window"] = None,
        flight_start: Annotated[float | None, "rad, shortest flight of the window"] = None,
        flight_stop: Annotated[float | None, "rad, longest flight of the window"] = None,
        energy: Annotated[bool, "the energy balance of every point as well"] = False,
        prove: Annotated[bool, "whether all folds and flips are counted, with a proof"] = False,
        along: Annotated[Literal["gamma", "omega", "xi"], "what varies; of a model, omega or xi too, from half to twice its value"] = "gamma",
        gamma: Annotated[float | None, "where another varies"] = None,
        doubled: Annotated[bool, "branches of twice the period that begin at flips as well"] = False,
        model: Annotated[Literal["rigid", "soft"] | None, "contact whose cycles are followed; default: the ideal plate in closed form"] = None,
        restitution: Annotated[float | None, "of the model"] = None,
        penetration: Annotated[float | None, "of a soft model, in plate amplitudes"] = None,
        adhesive: Annotated[bool, "whether a soft model pulls before take-off"] = True,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """Branches of cycles of one bounce, and their events.

        They are stable and unstable, in closed form, on a rigid contact without restitution. A branch that
        leaves `gamma_max` and comes back is several pieces. Within a window, from `start` to `stop` and from
        `flight_start` to `flight_stop`, a branch is as smooth as a whole one without it. With `prove`,
        `event_complete` says whether all events of a kind were counted.

        With a `model`, workers follow the contact's own cycles from those of the closed form, some seconds at
        most once compiled. With rebound a branch may pass through numbers of `flights`; it also ends at the
        event `stick-vanishes`, `rest`, `below-surface` or `unknown-change`, or at `cut-off`, beyond the points
        asked for. Branches `along` omega or xi pass through the cycles that the contact has at `gamma`.
        `doubled` adds up to 12 branches of twice the period; `flight_time` then has all flights that count, the
        longest first.

        Returns a Dataset with the attribute `complete` and the variables `gamma`, `flight_time` (rad),
        `takeoff_phase` (rad), `elongation` (plate amplitudes), `elongation_velocity` (plate amplitudes per
        rad), `impact_velocity` (plate amplitudes per rad), `multipliers`, `stable`, `violations`, `flights`,
        `cycle_state`, `plate_contact` (m A² ω²), `plate_impact` (m A² ω²), `dashpot` (m A² ω²), `impact` (m
        A² ω²), `force` (m A ω), `impulse` (m A ω), `weight` (m A ω), `branch_bounces`, `branch_periods`,
        `points`, `event_complete`, `event_kind`, `event_gamma`, `event_omega`, `event_xi`, `event_bounces`,
        `event_periods`, `event_flight_time` (rad), `event_violations`, `event_multipliers`, `event_branch`.
        Waits up to `timeout` seconds for the workers, and shows `progress`. Raises BadRequest naming the
        parameter, TooLarge naming what fits.
        """
        return self.result("orbits", omega=omega, xi=xi, modes=modes, gamma_max=gamma_max, points=points, start=start, stop=stop, flight_start=flight_start, flight_stop=flight_stop, energy=energy, prove=prove, along=along, gamma=gamma, doubled=doubled, model=model, restitution=restitution, penetration=penetration, adhesive=adhesive, timeout=timeout, progress=progress)

    def curves(
        self,
        omega: float | None = None,
        xi: float | None = None,
        omega_start: float | None = None,
        omega_stop: float | None = None,
        xi_start: float | None = None,
        xi_stop: float | None = None,
        modes: Annotated[str, "bounces-periods, as 1-1,1-2; cycles of one bounce"] = "1-1,1-2",
        kinds: Annotated[str | None, "such as fold,flip; default: all"] = None,
        gamma_max: Annotated[float, "curves are cut above this Γ"] = 8.0,
        model: Annotated[Literal["rigid", "soft"] | None, "contact whose cycles are followed; default: the ideal plate in closed form"] = None,
        restitution: Annotated[float | None, "of the model"] = None,
        penetration: Annotated[float | None, "of a soft model, in plate amplitudes"] = None,
        adhesive: Annotated[bool, "whether a soft model pulls before take-off"] = True,
        timeout: float = 300.0,
        progress: Progress = True,
    ) -> "xarray.Dataset":
        """Curves of folds, flips and other events over Ω or ξ.

        The range is of one of them, at one value of the other. The events are the cusps, Bogdanov-Takens and
        fold-flip points at which curves meet or turn. Workers compute the curves, some seconds for each mode.
        With a `model` they are the folds and flips of its own cycles, and end at cusps and where the segments
        of a cycle change. The events are then where branches with too many points are `cut-off`.

        Returns a Dataset with the attribute `complete` and the variables `omega`, `xi`, `gamma`,
        `flight_time` (rad), `violations`, `curve_kind`, `curve_bounces`, `curve_periods`, `event_kind`,
        `event_gamma`, `event_omega`, `event_xi`, `event_bounces`, `event_periods`, `event_flight_time` (rad),
        `event_violations`, `event_multipliers`. Waits up to `timeout` seconds for the workers, and shows
        `progress`. Raises BadRequest naming the parameter, TooLarge naming what fits.
        """
        return self.result("curves", omega=omega, xi=xi, omega_start=omega_start, omega_stop=omega_stop, xi_start=xi_start, xi_stop=xi_stop, modes=modes, kinds=kinds, gamma_max=gamma_max, model=model, restitution=restitution, penetration=penetration, adhesive=adhesive, timeout=timeout, progress=progress)
