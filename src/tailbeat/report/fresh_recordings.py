"""Figures of new recordings of tail, servo and swims, compared with the twin, as in the paper."""

from pathlib import Path

from tailbeat.evaluate.fresh_recordings import overlays, read
from tailbeat.fish.description import Fish
from tailbeat.identify import tail_report
from tailbeat.identify.decay import static_loop
from tailbeat.identify.predict import predict
from tailbeat.identify.runs import as_run
from tailbeat.identify.tail import identify_tail
from tailbeat.report import bench_figures, figures


def draw(out: Path, twin: Fish) -> list[Path]:
    """Draw tail response, servo overlay and fluid fit, as in the paper; PNG and SVG each."""
    day = read(out)
    sweeps = [one for one in day.tail if "sweep" in one.name]
    static = next((one for one in day.tail if "static" in one.name), None)
    loop = None if static is None else static_loop(static)
    found = tail_report.combine(twin, identify_tail(sweeps), loop, None)
    swims = predict(twin, [as_run(one, twin) for one in day.fluid])
    rows, servo = [("held out", one) for one in swims[:2]], overlays(day, twin)
    made = []
    for end in (".svg", ".png"):
        paths = [out / f"{name}{end}" for name in ("tail", "servo", "fluid")]
        bench_figures.tail(found, static, paths[0], overwrite=True)
        bench_figures.servo(servo, paths[1])
        figures.measured_against_twin(rows, paths[2], overwrite=True)
        made += paths
    return made[:3]
