"""Sweeps of releases without certificates, as ledgers and stores have them."""

from worker.sweep.protocols import Rest
from worker.sweep.specification import REMOVED, SETTLE, Periods, Settle, SweepSpec


class EarlierSweep(SweepSpec):
    """A sweep with the fields of REMOVED: it can be read, and has the id that it had."""

    settle: Settle = 200
    settle_tolerance: float = 0.0
    settle_until: Periods | None = None
    settle_early: bool = True

    def today(self) -> SweepSpec:
        """The sweep that computes it anew; where settling cells went on, with certificates."""
        fields = {name: value for name, value in self.as_submitted().items() if name not in REMOVED}
        if self.settle_until is not None:
            goes_on = self.settle_until >= SETTLE + 2 * self.observe
            fields |= {"settle": "auto", "until": self.settle_until if goes_on else None}
        return SweepSpec.parse(fields)

    def left_out(self) -> set[str]:
        """Of the removed fields, those that were off or without effect."""
        off = {name for name in ("settle_tolerance", "settle_until") if not getattr(self, name)}
        had_effect = isinstance(self.protocol, Rest) and not self.exponents
        if self.settle_early or not had_effect or getattr(self.model, "events", "located") == "plain":
            off.add("settle_early")
        return super().left_out() | off
