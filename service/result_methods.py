"""A method for each result. Made by service.views.client_methods: do not edit."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

if TYPE_CHECKING:
    from collections.abc import Callable

    import xarray


class ResultMethods(ABC):
    """A method for each result of a job."""

    #: The formats of each result, and the variables whose numbers are the rows of printed tables.
    FORMATS: ClassVar[dict[str, tuple[str, ...]]] = {
        "diagram": ("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"),
        "modes": ("json", "bin", "nc", "csv", "parquet"),
        "threshold": ("json", "bin", "nc", "csv", "parquet"),
        "orbits": ("json", "bin", "nc", "csv", "parquet"),
        "basins": ("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"),
        "multistability": ("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"),
        "trajectory": ("json", "bin", "nc", "csv", "parquet"),
    }
    PRINTED: ClassVar[dict[str, tuple[str, ...]]] = {
        "diagram": ("flight_time",),
        "modes": ("outcome",),
        "threshold": ("up_status",),
        "orbits": ("event_gamma", "skipped_gamma"),
        "basins": ("attractor_fraction",),
        "multistability": ("cells",),
        "trajectory": ("plate",),
    }

    @abstractmethod
    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name."""

    def diagram(
        self,
        along: Annotated[Literal["gamma", "omega", "xi"], "axis of the diagram"] = "gamma",
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: all that the sweep has, a dimension if two"] = None,
        min_flight: Annotated[float | None, "rad; shorter flights do not count, unless all of a cell are; default: micro_flight"] = None,
        every: Annotated[int, "return every n-th value only"] = 1,
        start: Annotated[float | None, "smallest value of the axis"] = None,
        stop: Annotated[float | None, "largest value of the axis"] = None,
        caption: Annotated[bool, "of a picture: how it was computed, above it"] = True,
    ) -> "xarray.Dataset":
        """The flights of the cells along an axis.

        A sweep ramped both ways has the dimension `direction`, unless one is selected. Flights up to
        `min_flight` do not count, neither here, where they are NaN, nor for `outcome`, `bounces` and `periods`,
        unless all of a cell are so short.

        Parameters
        ----------
        along : Literal["gamma", "omega", "xi"]
            axis of the diagram
        gamma : float | None
        omega : float | None
        xi : float | None
        direction : str | None
            rest, up or down; default: all that the sweep has, a dimension if two
        min_flight : float | None
            rad; shorter flights do not count, unless all of a cell are; default: micro_flight
        every : int
            return every n-th value only
        start : float | None
            smallest value of the axis
        stop : float | None
            largest value of the axis
        caption : bool
            of a picture: how it was computed, above it

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `flight_time` (rad): flight time, last flights of the window in order
            - `takeoff_phase` (rad): plate phase at take-off, modulo 2 pi
            - `flights`: flights taken off and landed within the window
            - `bounces`: mode: bounces in one cycle, 0 if none was found
            - `periods`: mode: plate periods in one cycle, 0 if none was found
            - `lyapunov`: Lyapunov exponents, the largest first
            - `lyapunov_error`: standard error of the largest Lyapunov exponent
            - `computed`: whether the cell was computed
            - `outcome`: what became of the cell
            - `label`: outcome, with aperiodic and unstable cells told apart by Lyapunov exponents

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("diagram", along=along, gamma=gamma, omega=omega, xi=xi, direction=direction, min_flight=min_flight, every=every, start=start, stop=stop, caption=caption)

    def modes(
        self,
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: all that the sweep has, a dimension if two"] = None,
        min_flight: Annotated[float | None, "rad; shorter flights do not count, unless all of a cell are; default: micro_flight"] = None,
        every: Annotated[int, "return every n-th value only"] = 1,
        hysteresis: Annotated[bool, "of a sweep ramped both ways: where they differ"] = False,
        gamma_start: float | None = None,
        gamma_stop: float | None = None,
        omega_start: float | None = None,
        omega_stop: float | None = None,
    ) -> "xarray.Dataset":
        """Outcome, bounces and plate periods of every cell.

        The cells are those of the plane at one ξ. A sweep ramped both ways has the dimension `direction`,
        unless one is selected. An adaptive map has `computed`: the other cells have the values of the nearest
        corner or centre of their block. The attribute `computed_share` is the share of cells that were computed.

        Parameters
        ----------
        xi : float | None
        direction : str | None
            rest, up or down; default: all that the sweep has, a dimension if two
        min_flight : float | None
            rad; shorter flights do not count, unless all of a cell are; default: micro_flight
        every : int
            return every n-th value only
        hysteresis : bool
            of a sweep ramped both ways: where they differ
        gamma_start : float | None
        gamma_stop : float | None
        omega_start : float | None
        omega_stop : float | None

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `bounces`: mode: bounces in one cycle, 0 if none was found
            - `periods`: mode: plate periods in one cycle, 0 if none was found
            - `outcome`: what became of the cell
            - `label`: outcome, with aperiodic and unstable cells told apart by Lyapunov exponents
            - `computed`: whether the cell was computed
            - `hysteresis`: how the ramps up and down compare

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("modes", xi=xi, direction=direction, min_flight=min_flight, every=every, hysteresis=hysteresis, gamma_start=gamma_start, gamma_stop=gamma_stop, omega_start=omega_start, omega_stop=omega_stop)

    def threshold(
        self,
        xi: float | None = None,
        tolerance: Annotated[float | None, "in Γ: refine the thresholds beyond the grid, from the sweep's stored states"] = None,
        predict: Annotated[Literal["none", "some", "all", "words"], "thresholds in closed form: of no Ω, of up to 200, of all by the workers, or of all with words continued from the sweep's cells where it is unresolved"] = "some",
        timeout: float = 300.0,
        progress: "bool | Callable[[int, int], None]" = True,
    ) -> "xarray.Dataset":
        """Where bouncing begins and ends, per Ω.

        At one ξ: as the sweep's cells show it, beside Eq. 25 and the closed form. `up` and `down` are values of
        the grid, or with a `tolerance` refined by workers. They are NaN unless their status is `found`:

        - `below the grid`: the lowest Γ bounces already
        - `above the grid`: every cell is at rest
        - `never bounces`: of `up`, every cell is at rest and Eq. 25 is above every Γ that a specification may
          have; of `down`, no cell of the ramp bounces
        - `not ramped`: the sweep does not have this direction
        - `not refined`: the grid holds the change, and refinement reached its limit
        - `missing`, `unresolved`, `diverged`, `settling`: the outcome of the cell that decides, the lowest that
          is not at rest

        `predicted_down` is the lowest Γ at which anything bounces for ever on the contact that the attribute
        `prediction` names; a descent ends there or earlier, on another cycle. Workers predict what takes longer
        than a second.

        Parameters
        ----------
        xi : float | None
        tolerance : float | None
            in Γ: refine the thresholds beyond the grid, from the sweep's stored states
        predict : Literal["none", "some", "all", "words"]
            thresholds in closed form: of no Ω, of up to 200, of all by the workers, or of all with words
              continued from the sweep's cells where it is unresolved
        timeout : float
            Seconds to wait for the workers.
        progress : bool or callable
            Shows the parts done, or is called with their number and all.

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `analytic`: threshold Γ from rest by Eq. 25
            - `up`: lowest Γ that bounces, ascending or from rest
            - `down`: lowest Γ that bounces, descending
            - `predicted_jump`: Γ of the fold at which flights leap
            - `predicted_down`: lowest Γ at which anything bounces for ever, predicted
            - `up_status`: why up is a number or NaN
            - `down_status`: why down is a number or NaN
            - `cause`: what ends bouncing at predicted_down, or why that is NaN
            - `difference`: why down and predicted_down differ
            - `up_computed`: of an adaptive map: whether both cells beside up were computed

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("threshold", xi=xi, tolerance=tolerance, predict=predict, timeout=timeout, progress=progress)

    def orbits(
        self,
        omega: float | None = None,
        xi: float | None = None,
        direction: Annotated[str | None, "rest, up or down; default: the first direction of the sweep"] = None,
        gamma_max: Annotated[float, "branches and curves are cut above this Γ"] = 8.0,
        energy: Annotated[bool, "the energy balance of every point as well"] = False,
        timeout: float = 300.0,
        progress: "bool | Callable[[int, int], None]" = True,
    ) -> "xarray.Dataset":
        """Branches of the cycles that cells along Γ settled to.

        Stable and unstable ones, with their events, of the rigid contact without restitution: cells of another
        contact are a guess from which its cycles are looked for. A worker follows a branch in some tenths of a
        second. `skipped` are the periodic cells from which no branch was followed.

        Parameters
        ----------
        omega : float | None
        xi : float | None
        direction : str | None
            rest, up or down; default: the first direction of the sweep
        gamma_max : float
            branches and curves are cut above this Γ
        energy : bool
            the energy balance of every point as well
        timeout : float
            Seconds to wait for the workers.
        progress : bool or callable
            Shows the parts done, or is called with their number and all.

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `gamma`: plate acceleration over gravity
            - `multipliers`: Floquet multipliers, the larger first
            - `stable`: whether both multipliers are inside the unit circle
            - `admissible`: why the cycle is not one of the spring
            - `flight_time` (rad): flight time
            - `takeoff_phase` (rad): plate phase at take-off, modulo 2 pi
            - `impact_velocity` (plate amplitudes per rad): velocity of the gap before landing
            - `plate_contact` (m A² ω²): work of the plate in contact
            - `plate_impact` (m A² ω²): work of the plate at the impact
            - `dashpot` (m A² ω²): energy that the dashpot takes
            - `impact` (m A² ω²): energy that the impact takes
            - `force` (m A ω): momentum that the contact force gives
            - `impulse` (m A ω): momentum that the impact gives
            - `weight` (m A ω): momentum that gravity takes, 4π periods/Γ
            - `branch_bounces`: bounces of the cycles
            - `branch_periods`: plate periods of the cycles
            - `points`: points of the branch
            - `word`: landings of the cycle: s sticks, z takes off again at once
            - `event_kind`: kind of event
            - `event_gamma`: plate acceleration over gravity
            - `event_omega`: plate frequency over the spring's natural frequency
            - `event_xi`: damping ratio of the spring
            - `event_bounces`: bounces of the cycle
            - `event_periods`: plate periods of the cycle
            - `event_flight_time` (rad): flight time
            - `event_admissible`: why the cycle is not one of the spring
            - `event_multipliers`: Floquet multipliers
            - `event_branch`: index of the branch that the event is on
            - `skipped_gamma`: plate acceleration over gravity
            - `skipped_bounces`: bounces of the cell from which no branch was followed
            - `skipped_periods`: plate periods of the cell from which no branch was followed
            - `skipped_reason`: why no branch was followed from the cell

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("orbits", omega=omega, xi=xi, direction=direction, gamma_max=gamma_max, energy=energy, timeout=timeout, progress=progress)

    def basins(
        self,
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
    ) -> "xarray.Dataset":
        """The attractors of one cell, and their basins.

        Attractors are numbered from 1 by the share of the starts of the plane that reach them. A start without
        an attractor has the number 0.

        Parameters
        ----------
        gamma : float | None
        omega : float | None
        xi : float | None

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `attractor_of_start`: attractor that a start reaches
            - `attractor_fraction`: share of the starts that reach the attractor
            - `attractor_outcome`: what the attractor does
            - `attractor_bounces`: bounces in one cycle, 0 without a cycle
            - `attractor_periods`: plate periods in one cycle, 0 without a cycle
            - `attractor_longest_flight` (rad): longest flight
            - `attractor_lifetime` (plate periods): life of aperiodic motion that was seen to end
            - `attractor_flight_time` (rad): last flights of a window in order
            - `attractor_takeoff_phase` (rad): plate phase at take-off, modulo 2 pi
            - `attractor_state`: a state on the attractor, in the cell's own units
            - `attractor_lyapunov`: Lyapunov exponents, the largest first
            - `attractor_count`: attractors of the cell, also those beyond the dimension id
            - `undecided`: share of the starts without an attractor
            - `basin_entropy`: basin entropy, of boxes of 8 by 8 starts
            - `boundary_entropy`: boundary basin entropy, of boxes of 8 by 8 starts
            - `attractor_label`: what the attractor does

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("basins", gamma=gamma, omega=omega, xi=xi)

    def multistability(
        self,
        xi: float | None = None,
        omega: Annotated[float | None, "the nearest line along gamma alone"] = None,
    ) -> "xarray.Dataset":
        """The attractors of every cell at one ξ.

        They are matched from cell to cell, with births, deaths and changes of mode as events. One attractor has
        one `id` in all cells; ids are numbered from 1 by the number of cells. With `omega` only the line along Γ
        nearest to it, with the flights of every attractor. The attribute `several` is the share of cells with two
        attractors or more, `several_by_drops` the same without attractors that no drop reaches.

        Parameters
        ----------
        xi : float | None
        omega : float | None
            the nearest line along gamma alone

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `count`: attractors of the cell
            - `id`: attractor of the plane
            - `label`: what the attractor does
            - `fraction`: share of the starts that reach the attractor
            - `longest_flight` (rad): longest flight
            - `flight_time` (rad): last flights of a window in order
            - `attractor_label`: what the attractor does in most cells
            - `cells`: cells of the attractor
            - `event_kind`: birth, death or mode, with gamma growing
            - `event_attractor`: attractor of the event
            - `event_omega`: omega of the event
            - `event_gamma_below`: gamma of the cell below the event
            - `event_gamma_above`: gamma of the cell above the event
            - `event_below`: label of the attractor below
            - `event_above`: label of the attractor above
            - `event_leads_to`: attractor that takes the place of one born or dying

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
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
    ) -> "xarray.Dataset":
        """The motion of one cell of a job.

        As it settles from rest, where the ramp left it, or on one of its attractors. Lengths are in plate
        amplitudes; the attribute `rest_length` is that of the spring. Flights are those that start and end within
        the samples. Refused for a cell of a ramp that is not computed yet, or that is unresolved or diverged: its
        stored state is where the computation stopped.

        Parameters
        ----------
        gamma : float | None
        omega : float | None
        xi : float | None
        direction : str | None
            rest, up or down; default: the first direction of the sweep
        attractor : int | None
            of a job of basins or multistability: which attractor of the cell, from 1
        periods : int
            plate periods
        samples : int
            per plate period

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `plate` (plate amplitudes): plate
            - `z1` (plate amplitudes): upper mass
            - `z2` (plate amplitudes): lower mass
            - `force` (m A ω²): force of the plate on the lower mass
            - `in_flight`: whether the spring is off the plate
            - `takeoff` (rad): phase of the plate at take-off, as `phase`
            - `takeoff_phase` (rad): plate phase at take-off, modulo 2 pi
            - `flight_time` (rad): flight time
            - `cycle_bounces`: bounces of the cycle
            - `cycle_periods`: plate periods of the cycle
            - `cycle_flight_time` (rad): flight time of the cycle
            - `cycle_multipliers`: Floquet multipliers, real and imaginary
            - `cycle_stable`: whether both multipliers are inside the unit circle
            - `cycle_admissible`: 0, or the sum of the conditions that fail
            - `energy_plate_contact` (m A² ω²): work of the plate in contact
            - `energy_plate_impact` (m A² ω²): work of the plate at the impact
            - `energy_dashpot` (m A² ω²): energy that the dashpot takes
            - `energy_impact` (m A² ω²): energy that the impact takes
            - `energy_force` (m A ω): momentum that the contact force gives
            - `energy_impulse` (m A ω): momentum that the impact gives
            - `energy_weight` (m A ω): momentum that gravity takes

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("trajectory", gamma=gamma, omega=omega, xi=xi, direction=direction, attractor=attractor, periods=periods, samples=samples)


class SpringMethods(ABC):
    """A method for each result of a spring."""

    #: The formats of each result, and the variables whose numbers are the rows of printed tables.
    FORMATS: ClassVar[dict[str, tuple[str, ...]]] = {
        "threshold": ("json", "bin", "nc"),
        "orbits": ("json", "bin", "nc", "csv", "parquet"),
        "curves": ("json", "bin", "nc", "csv", "parquet"),
    }
    PRINTED: ClassVar[dict[str, tuple[str, ...]]] = {
        "threshold": (),
        "orbits": ("event_gamma",),
        "curves": ("event_gamma",),
    }

    @abstractmethod
    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name."""

    def threshold(
        self,
        omega: float,
        xi: float,
        delta: Annotated[float, "Γ below `down` for which the lifetime is told"] = 1e-06,
        timeout: float = 300.0,
        progress: "bool | Callable[[int, int], None]" = True,
    ) -> "xarray.Dataset":
        """Where one spring begins and ceases to bounce.

        In closed form, of the rigid contact without restitution. `down` is the lowest Γ at which anything bounces
        for ever, by a rule that no search contradicts at its damping: `cause` is `not searched` below that, and
        `unresolved` where the rule does not decide. A slow descent ends there or earlier, where the cycle that it
        is on ends. Below a fold bouncing lives for `lifetime`; the energy balance is that of the cycle at the
        fold. A worker computes what takes longer than a second.

        Parameters
        ----------
        omega : float
        xi : float
        delta : float
            Γ below `down` for which the lifetime is told
        timeout : float
            Seconds to wait for the workers.
        progress : bool or callable
            Shows the parts done, or is called with their number and all.

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `threshold`: Γ at which rest ends, Eq. 25
            - `jump`: Γ of the fold at which flights leap on the way up
            - `down`: lowest Γ at which anything bounces for ever
            - `cause`: what ends bouncing at down
            - `reason`: why down is not decided
            - `lifetime` (plate periods): life of bouncing at Γ = down - delta
            - `delta`: Γ below down
            - `plate_contact` (m A² ω²): work of the plate in contact
            - `plate_impact` (m A² ω²): work of the plate at the impact
            - `dashpot` (m A² ω²): energy that the dashpot takes
            - `impact` (m A² ω²): energy that the impact takes
            - `force` (m A ω): momentum that the contact force gives
            - `impulse` (m A ω): momentum that the impact gives
            - `weight` (m A ω): momentum that gravity takes, 4π periods/Γ

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("threshold", omega=omega, xi=xi, delta=delta, timeout=timeout, progress=progress)

    def orbits(
        self,
        omega: float,
        xi: float,
        modes: Annotated[str, "bounces-periods, as 1-1,1-2; cycles of one bounce"] = "1-1,1-2",
        gamma_max: Annotated[float, "branches and curves are cut above this Γ"] = 8.0,
        points: Annotated[int, "of each branch, at least"] = 400,
        energy: Annotated[bool, "the energy balance of every point as well"] = False,
        timeout: float = 300.0,
        progress: "bool | Callable[[int, int], None]" = True,
    ) -> "xarray.Dataset":
        """Branches of cycles of one bounce, and their events.

        Stable and unstable ones, in closed form, of the rigid contact without restitution. A branch that leaves
        `gamma_max` and comes back is several pieces.

        Parameters
        ----------
        omega : float
        xi : float
        modes : str
            bounces-periods, as 1-1,1-2; cycles of one bounce
        gamma_max : float
            branches and curves are cut above this Γ
        points : int
            of each branch, at least
        energy : bool
            the energy balance of every point as well
        timeout : float
            Seconds to wait for the workers.
        progress : bool or callable
            Shows the parts done, or is called with their number and all.

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `gamma`: plate acceleration over gravity
            - `flight_time` (rad): flight time
            - `takeoff_phase` (rad): plate phase at take-off, modulo 2 pi
            - `elongation` (plate amplitudes): elongation of the spring at take-off
            - `elongation_velocity` (plate amplitudes per rad): velocity of the elongation at take-off
            - `impact_velocity` (plate amplitudes per rad): velocity of the gap before landing
            - `multipliers`: Floquet multipliers, the larger first
            - `stable`: whether both multipliers are inside the unit circle
            - `admissible`: why the cycle is not one of the spring
            - `plate_contact` (m A² ω²): work of the plate in contact
            - `plate_impact` (m A² ω²): work of the plate at the impact
            - `dashpot` (m A² ω²): energy that the dashpot takes
            - `impact` (m A² ω²): energy that the impact takes
            - `force` (m A ω): momentum that the contact force gives
            - `impulse` (m A ω): momentum that the impact gives
            - `weight` (m A ω): momentum that gravity takes, 4π periods/Γ
            - `branch_bounces`: bounces of the cycles
            - `branch_periods`: plate periods of the cycles
            - `points`: points of the branch
            - `event_kind`: kind of event
            - `event_gamma`: plate acceleration over gravity
            - `event_omega`: plate frequency over the spring's natural frequency
            - `event_xi`: damping ratio of the spring
            - `event_bounces`: bounces of the cycle
            - `event_periods`: plate periods of the cycle
            - `event_flight_time` (rad): flight time
            - `event_admissible`: why the cycle is not one of the spring
            - `event_multipliers`: Floquet multipliers

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("orbits", omega=omega, xi=xi, modes=modes, gamma_max=gamma_max, points=points, energy=energy, timeout=timeout, progress=progress)

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
        gamma_max: Annotated[float, "branches and curves are cut above this Γ"] = 8.0,
        timeout: float = 300.0,
        progress: "bool | Callable[[int, int], None]" = True,
    ) -> "xarray.Dataset":
        """Curves of folds, flips and other events over Ω or ξ.

        Over a range of one of them, at one value of the other. The events are the cusps, Bogdanov-Takens and
        fold-flip points at which curves meet or turn. Workers compute the curves, some seconds for each mode.

        Parameters
        ----------
        omega : float | None
        xi : float | None
        omega_start : float | None
        omega_stop : float | None
        xi_start : float | None
        xi_stop : float | None
        modes : str
            bounces-periods, as 1-1,1-2; cycles of one bounce
        kinds : str | None
            such as fold,flip; default: all
        gamma_max : float
            branches and curves are cut above this Γ
        timeout : float
            Seconds to wait for the workers.
        progress : bool or callable
            Shows the parts done, or is called with their number and all.

        Returns
        -------
        xarray.Dataset
            With the attribute `complete` and these variables:

            - `omega`: plate frequency over the spring's natural frequency
            - `xi`: damping ratio of the spring
            - `gamma`: plate acceleration over gravity
            - `flight_time` (rad): flight time
            - `admissible`: why the cycle is not one of the spring
            - `curve_kind`: kind of event
            - `curve_bounces`: bounces of the cycles
            - `curve_periods`: plate periods of the cycles
            - `event_kind`: kind of event
            - `event_gamma`: plate acceleration over gravity
            - `event_omega`: plate frequency over the spring's natural frequency
            - `event_xi`: damping ratio of the spring
            - `event_bounces`: bounces of the cycle
            - `event_periods`: plate periods of the cycle
            - `event_flight_time` (rad): flight time
            - `event_admissible`: why the cycle is not one of the spring
            - `event_multipliers`: Floquet multipliers

        Raises
        ------
        BadRequest
            Names the parameter.
        TooLarge
            Names what fits.
        """
        return self.result("curves", omega=omega, xi=xi, omega_start=omega_start, omega_stop=omega_stop, xi_start=xi_start, xi_stop=xi_stop, modes=modes, kinds=kinds, gamma_max=gamma_max, timeout=timeout, progress=progress)
