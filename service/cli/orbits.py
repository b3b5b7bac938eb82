"""The thresholds of one spring in closed form, as text."""

from math import isfinite
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray


def threshold_text(found: "xarray.Dataset") -> str:
    """The thresholds of one spring, one per line."""
    values = {name: found[name].item() for name in ("omega", "xi", "threshold", "jump", "down")}
    lines = [f"omega {values['omega']:g}, xi {values['xi']:g}: rigid contact without restitution"]
    lines.append(f"rest ends on the way up    {_gamma(values['threshold'])}  Eq. 25")
    lines.append(f"flights leap on the way up {_gamma(values['jump'])}")
    cause, reason = found.cause.item(), found.reason.item()
    lines.append(f"nothing bounces below      {_gamma(values['down'])}  {cause}")
    if reason:
        lines.append(f"{cause}: {reason}")
    lifetime = found.lifetime.item()
    if isfinite(lifetime):
        lines.append(f"{found.delta.item():g} below the fold bouncing lives {lifetime:,.0f} periods")
    return "\n".join(lines)


def plain(found: "xarray.Dataset") -> dict[str, Any]:
    """A Dataset as plain values by name, null for what is not finite, complex numbers as their two parts."""
    names = [*found.coords, *found.data_vars]
    return {str(name): _plain(found[name].values.tolist()) for name in names}


def _gamma(value: float) -> str:
    return f"{value:12.9f}" if isfinite(value) else f"{'-':>12}"


def _plain(value: Any) -> Any:
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    if isinstance(value, complex):
        return [_plain(value.real), _plain(value.imag)]
    return None if isinstance(value, float) and not isfinite(value) else value
