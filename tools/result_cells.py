"""How a number of a result becomes a cell of a table. None is a number that there is not."""

import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import result_files
from tailbeat.files import BadInput

NONE = "–"


def fix(value: float | None, digits: int = 0, by: float = 1.0) -> str:
    """A number times `by`, with so many digits after the point."""
    if value is None:
        return NONE
    text = f"{by * value:,.{digits}f}"
    return text[1:] if float(text.replace(",", "")) == 0 and text.startswith("-") else text


def sig(value: float | None, digits: int = 3, by: float = 1.0) -> str:
    """A number times `by`, with so many significant digits and no exponent."""
    if value is None:
        return NONE
    shown = f"{by * value:.{digits - 1}e}"
    mantissa, exponent = shown.split("e")
    return f"{float(shown):.{max(digits - 1 - int(exponent), 0)}f}" if mantissa else shown


def span(interval: Sequence[float], digits: int = 3, by: float = 1.0) -> str:
    """An interval, each end with so many significant digits."""
    low, high = (sig(end, digits, by) for end in (interval[0], interval[1]))
    return f"{low} … {high}"


def per_cent(value: float | None, digits: int = 1) -> str:
    """A fraction in per cent."""
    return NONE if value is None else f"{fix(value, digits, 100.0)} %"


def off(value: float, truth: float) -> str:
    """How far a value is from the truth, in per cent of the truth."""
    return per_cent(abs(value / truth - 1))


def rate(row: Any, key: str = "arrived") -> str:
    """A success rate: how many of how many, and its 95 % interval in per cent."""
    count = row["swims" if "swims" in row else "targets"]
    low, high = (100 * end for end in row[f"{key}_interval"])
    hits = round(row[key] * count)
    return f"{hits:,} of {count:,} ({_end(low)}–{_end(high)} %)"


def _end(value: float) -> str:
    """An end of an interval in per cent; 100 stands without digits after the point."""
    return "100" if value > 99.9999 else f"{value:.1f}"


def made(result: Any) -> str:
    """How a result was made: its steps, then date, versions, machine and time, and which of its
    fish and policies changed since."""
    origin = result["origin"]
    steps = "\n".join(origin["steps"])
    where = f"{origin['processor']}, {origin['machine']}"
    return (
        f"```\n{steps}\n```\n\n"
        f"{origin['date']}, tailbeat {origin['tailbeat']} (commit {origin['commit']}),\n{where};"
        f" {minutes(result):.1f} minutes at a load of {origin['load']}."
        f"{earlier(result)}"
    )


def earlier(result: Any) -> str:
    """A line with the fish and policies that a result was not measured with in their state of
    today; nothing where there are none."""
    names = result_files.changed(result["origin"])
    return "\n" + _listed("**Measured before today's version of:**", names) if names else ""


def stale(**named: Any) -> str:
    """A sentence with the results whose fish or policies changed since; nothing if none."""
    found = [name for name, result in named.items() if earlier(result)]
    return _listed("Measured with an earlier fish or policy:", found) if found else ""


def _listed(words: str, names: Sequence[str]) -> str:
    """Words and names as a sentence, in lines that a page may have."""
    text = f"{words} {', '.join(f'`{name}`' for name in names)}."
    return textwrap.fill(text, width=98, break_on_hyphens=False)


# How a unit of the JSON stands in a table: factor, digits after the point, and name.
SHOWN = {"m/s": (1000, 1, " mm/s"), "m": (1000, 1, " mm"), "1": (100, 1, " %"), "deg": (1, 1, "°")}


def error(value: float | None, unit: str) -> str:
    """An error in the unit that a reader expects."""
    by, digits, name = SHOWN[unit]
    return f"{fix(value, digits, by)}{name}"


def hits(row: Any, key: str = "arrived") -> int:
    """How many targets were reached."""
    return round(row[key] * row["targets"])


def unique(rows: Any, name: str) -> list[Any]:
    """Values of a column, each once, in their order."""
    return list(dict.fromkeys(row[name] for row in rows))


def pick(rows: Any, **wanted: Any) -> Any:
    """The row whose fields have these values. Raises BadInput where there is none."""
    found = [row for row in rows if all(row[name] == value for name, value in wanted.items())]
    if not found:
        raise BadInput(f"no row with {wanted}; make the result again.")
    return found[0]


def met(seeds: Any, asked: Any) -> str:
    """How many of the four seeds of a result reach the rates that were `asked` at each level, the
    first of which is clean; a line each."""
    rates = [[row["arrived"] for row in seeds[f"seed_{seed}"]["messy"]] for seed in range(4)]
    levels = enumerate(("everyday", "rough", "wrecked"), start=1)
    counts = {name: sum(one[k] >= asked[name] for one in rates) for k, name in levels}
    return "\n".join(f"{n} of four meet what was asked at `{name}`." for name, n in counts.items())


def margin(row: Any) -> str:
    """A margin and its interval, each "over" the largest size tried where fewer never arrived."""
    most = f"over {sig(row['most'])}"
    size, low, high = (most if x is None else sig(x) for x in (row["size"], *row["interval"]))
    return f"{size} ({low} – {high})"


def largest(rows: Any, name: str) -> float | None:
    """Largest value of a column; None where one is missing, which is worse than any number."""
    found = [row[name] for row in rows]
    return None if None in found or not found else max(found)


def smallest(rows: Any, name: str) -> float | None:
    """Smallest value of a column, None where one is missing."""
    found = [row[name] for row in rows]
    return None if None in found or not found else min(found)


def total(rows: Any, name: str) -> float:
    """Sum of a column."""
    return float(sum(row[name] for row in rows))


def timed(rows: Any) -> list[Any]:
    """The rows of targets that go by the clock, and of those that stay: none that waits."""
    return [row for row in rows if "led" not in row["condition"]]


def recovered(rows: Any, launch: float) -> str:
    """How many beats end forward after a launch [m/s], and their final speeds, lowest to highest.
    A speed is missing where the twin diverged."""
    ends = [row["speed"] for row in rows if row["launch"] == launch]
    known = [end for end in ends if end is not None]
    forward = sum(end > 0 for end in known)
    return f"{forward} of {len(ends)}, {fix(min(known), 2)} to {fix(max(known), 2)}"


def minutes(result: Any) -> float:
    """Time of all steps of a result [min]."""
    return float(sum(result["origin"]["seconds"]) / 60)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    one.__name__: one
    for one in (
        fix,
        sig,
        span,
        per_cent,
        off,
        rate,
        made,
        stale,
        error,
        margin,
        met,
        largest,
        smallest,
        total,
        timed,
        recovered,
    )
} | {"minutes": minutes, "hits": hits, "unique": unique, "pick": pick, "len": len}
