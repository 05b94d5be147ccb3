"""The paper's numbers of its own fish in its own pool, compared with an evaluation's."""

from collections.abc import Callable

from tailbeat.evaluate import disturb, spectrum, track
from tailbeat.evaluate.evaluation import Evaluation
from tailbeat.evaluate.rates import SuccessRates
from tailbeat.evaluate.reach import ReachResult
from tailbeat.report.tables import percent


def arrived(rates: SuccessRates | None) -> str:
    """Success rate within 5 cm with its interval [%]."""
    return "-" if rates is None else percent(rates.arrived, rates.arrived_interval)


def near(rates: SuccessRates | None) -> str:
    """Success rate within 20 cm with its interval [%]."""
    return "-" if rates is None else percent(rates.near, rates.near_interval)


def beside_paper(data: Evaluation) -> list[dict[str, str]]:
    """The paper's numbers of its own fish in its own pool (targets placed by hand), and ours."""
    return [{"": name, "paper": text, "here": ours(data) or "-"} for name, text, ours in PAPER]


def _open_water(data: Evaluation) -> ReachResult | None:
    return data.reach.get("reach open")


def _static(show: Callable[[SuccessRates | None], str]) -> Callable[[Evaluation], str]:
    """Success rate in the paper's trained range."""

    def ours(data: Evaluation) -> str:
        found = _open_water(data)
        return "" if found is None else f"{show(found.trained_range)} %"

    return ours


def _lateral(data: Evaluation) -> str:
    found = _open_water(data)
    rows = [] if found is None else [row for row in found.sectors if row.low == 90]
    return f"{near(rows[0])} %" if rows else ""


def _perturbed(field: str) -> Callable[[Evaluation], str]:
    """Success rate under each disturbance."""

    def ours(data: Evaluation) -> str:
        rows = [row for row in data.disturb if row.condition != disturb.CALM]
        found = ", ".join(f"{100 * getattr(row, field):.0f}" for row in rows)
        names = ", ".join(row.condition.removeprefix("disturb ") for row in rows)
        return f"{found} % ({names})" if rows else ""

    return ours


def _crossings(data: Evaluation) -> str:
    crossed = {row.condition: f"{row.two_crossings} of {row.swims}" for row in data.track}
    if not crossed:
        return ""
    timed, led = crossed[track.EIGHT], crossed[track.LED_EIGHT]
    return f"{timed} on a fixed schedule, {led} if the target waits for the fish"


def _power_below(runs: str) -> Callable[[Evaluation], str]:
    """Velocity power below the band's upper edge."""

    def ours(data: Evaluation) -> str:
        rows = [row for row in data.spectrum if (row.runs, row.gait) == (runs, "all")]
        known = [row.share_below for row in rows if row.share_below is not None]
        return f"{100 * known[0]:.0f} %" if known else ""

    return ours


PAPER: tuple[tuple[str, str, Callable[[Evaluation], str]], ...] = (
    ("static targets within 5 cm", "11 of 22 (50 %)", _static(arrived)),
    ("static targets within 20 cm", "13 of 22 (59 %)", _static(near)),
    ("lateral rear, 90-120°, within 20 cm", "0 of 4", _lateral),
    ("perturbed targets within 5 cm", "5 of 8", _perturbed("arrived")),
    ("perturbed targets within 20 cm", "7 of 8", _perturbed("near")),
    ("figure-eight, 73 s: two clean crossings", "1 of 10", _crossings),
    ("velocity power below the band's upper edge: identification runs", "92 %",
     _power_below(spectrum.IDENTIFICATION)),
    ("velocity power below the band's upper edge: policy in its twin",
     "97 % (direct action 44 %)", _power_below("reach twin")),
    ("velocity power below the band's upper edge: deployed", "62 % (77 % rescaled)",
     _power_below("reach open")),
)  # fmt: skip
