"""The numbers that a fish's file lists as uncertain, as parameters of the fluid fit."""

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Uncertain
from tailbeat.fish.store import value_at
from tailbeat.identify.space import Parameter


def uncertain_parameters(fish: Fish) -> list[Parameter]:
    """A parameter for each; the fish's own value is its prior. Raises BadInput."""
    found = []
    for extra in fish.uncertain:
        prior = _known(fish, extra.field)
        _check_uncertain(fish, extra, prior)
        found.append(
            Parameter(
                extra.field, extra.unit, extra.low, extra.high, prior, extra.spread, extra.log
            )
        )
    return found


def _known(fish: Fish, field: str) -> float:
    """The number of an uncertain field. Raises BadInput."""
    try:
        return value_at(fish, field)
    except (KeyError, IndexError, TypeError, ValueError):
        raise BadInput(
            f"{fish.name}: uncertain field {field!r} is no number of the fish; give a path such as"
            f" tendons.slack, and a value there."
        ) from None


def _check_uncertain(fish: Fish, extra: Uncertain, prior: float) -> None:
    said, span = f"{fish.name}: uncertain field {extra.field}", f"{extra.low:g}-{extra.high:g} (SI)"
    if not extra.low <= prior <= extra.high:
        raise BadInput(
            f"{said} = {prior:g} is outside its range {span}; widen the range or correct the value."
        )
    if extra.log and extra.low <= 0:
        raise BadInput(
            f"{said} is searched by its logarithm, so its range {span} must lie above 0; raise low,"
            f" or write log = false."
        )
