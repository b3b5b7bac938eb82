"""A method for each result. Made by service.views.client_methods: do not edit."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray

#: The formats of each result.
FORMATS = {
    "basins": ("json", "bin", "nc", "csv", "parquet", "png", "svg", "pdf"),
}
#: The variable whose numbers are the rows of each result as a table.
ROWS = {
    "basins": "attractor_fraction",
}


class ResultMethods:
    """A method for each result."""

    def result(self, name: str, /, **query: Any) -> "xarray.Dataset":
        """The result of this name."""
        raise NotImplementedError

    def basins(
        self,
        gamma: float | None = None,
        omega: float | None = None,
        xi: float | None = None,
    ) -> "xarray.Dataset":
        """The attractors of one cell, and which of them each start of the plane reaches.

        Attractors are numbered from 1 by the share of the starts that reach them. A start without an
        attractor has the number 0.

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
