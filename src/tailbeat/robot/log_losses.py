"""What a log lacks, in sentences."""

from tailbeat.robot.log import Swim

GAPS = 5  # of which a sentence tells the times


def losses(swim: Swim) -> list[str]:
    """What a log lacks and what was done about it, a sentence each."""
    said = []
    if not swim.whole:
        said.append("the log has no end: its process was killed, or the file was cut off")
    if swim.damaged:
        said.append(f"the file is damaged: {_missing(swim)}")
    if swim.logs > 1:
        left = f"; {swim.left_out} not read: their times overlap" if swim.left_out else ""
        said.append(f"the file holds {swim.logs} logs, one after the other{left}")
    if swim.twice:
        said.append(f"{swim.twice} rows have the time of another and are left out")
    if not swim.sorted:
        said.append("its rows are not in the order of their times and were sorted")
    return said


def _missing(swim: Swim) -> str:
    """How many seconds and rows are missing, and where."""
    doubt = "; its end, which counts the rows, is damaged too" if swim.lost is None else ""
    if not swim.gaps and not swim.lost:
        return f"no row is missing{doubt and ' between the first and the last'}{doubt}"
    lost = sum(gap.seconds for gap in swim.gaps)
    rows = f" ({swim.lost} of {swim.lost + len(swim.rows) - swim.twice} rows)" if swim.lost else ""
    places = [
        "before the first row" if one.at < 0 else f"after {one.at:.2f} s" for one in swim.gaps
    ]
    more = f" and {len(places) - GAPS} more" if len(places) > GAPS else ""
    at = f", {', '.join(places[:GAPS])}{more}" if places else ""
    return f"{lost:.2f} s of rows are missing{at}{rows}{doubt if swim.whole else ''}"
