"""One page of what a folder holds: numbers beside the paper's, every figure, where it came from.

Computes nothing but what `evaluation.read` and `compare.read` give; the page needs no other file.
"""

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from tailbeat.evaluate import compare, evaluation, runs, spectrum, track
from tailbeat.evaluate.trial import CHUNK
from tailbeat.files import BadInput, new_file, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.report import figures, fresh_recordings, swim_figures

STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; margin: 1rem 0; font-size: 0.9rem; }
th, td { padding: 0.25rem 0.7rem; border-bottom: 1px solid #ccc; text-align: right; }
th:first-child, td:first-child { text-align: left; }
img, video { max-width: 100%; } .warn { background: #fff3cd; padding: 0.5rem 1rem; }
"""
# What the paper prints of its own fish in its own pool; targets placed by hand.
PAPER = {
    "static targets within 5 cm": "11 of 22 (50 %)",
    "static targets within 20 cm": "13 of 22 (59 %)",
    "lateral rear, 90-120°, within 20 cm": "0 of 4",
    "perturbed targets within 5 cm": "5 of 8",
    "perturbed targets within 20 cm": "7 of 8",
    "figure-eight, 73 s: two clean crossings": "1 of 10",
    "velocity power below the edge: identification runs": "92 %",
    "velocity power below the edge: policy in its twin": "97 % (direct action 44 %)",
    "velocity power below the edge: deployed": "62 % (77 % rescaled)",
}
Section = tuple[str, list[str]]  # heading, blocks of HTML


def write(out: Path, sections: Sequence[Section], data: dict[str, Any], title: str) -> Path:
    """`report.html` and `report.json` in a folder."""
    body = [f"<h1>{escape(title)}</h1>"]
    for heading, blocks in sections:
        body += [f"<h2>{escape(heading)}</h2>", *blocks]
    head = "<meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
    page = f"<!doctype html><html lang='en'><head>{head}<title>{escape(title)}</title>"
    page += f"<style>{STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    path = out / "report.html"
    with new_file(path, overwrite=True) as beside:
        beside.write_text(page, encoding="utf-8")
    write_json(out / "report.json", data, overwrite=True)
    return path


def report(
    out: Path, fish: Fish, twin: Fish, data: dict[str, Any] | None = None
) -> tuple[Path, dict[str, Any]]:
    """The page of an evaluation or a comparison, from its numbers where they are at hand, else read
    from the folder. Raises BadInput for a folder without either."""
    if (out / "plan.json").is_file():
        data = data or evaluation.read(out)
        return write(
            out, evaluated(out, data, fish, twin), data, "Zero-shot in the virtual pool"
        ), data
    if compare.has_rows(out):
        data = data or compare.read(out)
        return write(out, compared(out, data), data, "Which action space transfers"), data
    raise BadInput(f"{out}: holds neither an evaluation nor a comparison; make one first.")


def of_folder(
    out: Path, fish: str, twin: str | None = None, data: dict[str, Any] | None = None
) -> tuple[Path, dict[str, Any]]:
    """The page of a folder, with fish by name; `data` are its numbers, if they are at hand."""
    if not out.is_dir() or not any(out.iterdir()):
        raise BadInput(f"{out}: an empty or missing folder; evaluate into it first.")
    described = load_fish(fish)
    plan = out / "plan.json"
    held = evaluation.read_json(plan) if plan.is_file() else {}
    return report(out, described, load_fish(twin or held.get("twin", fish)), data)


# ---- an evaluation ------------------------------------------------------------------------------


def evaluated(out: Path, data: dict[str, Any], fish: Fish, twin: Fish) -> list[Section]:
    """Sections of an evaluation, figures drawn into `figures/`."""
    sections = [("Beside the paper", [_warnings(data), table(beside_paper(data))])]
    sections += _reach(out, data, fish)
    for task in ("disturb", "beyond"):
        if task in data:
            drawn = swim_figures.costs(data[task], "5cm", "within 5 cm")
            blocks = [table(_plain(data[task])), figure(drawn, out, task)]
            sections.append(
                ({"disturb": "Disturbed", "beyond": "Beyond the training"}[task], blocks)
            )
    if "track" in data:
        swims, _ = runs.load(out, track.ARM, 1)
        drawn = swim_figures.following(track.by_path(swims), data["track"])
        sections.append(("Following", [table(data["track"]), figure(drawn, out, "following")]))
    rows = data["spectrum"]
    if rows:
        drawn = swim_figures.power(rows, spectrum.BINS, data["plan"]["band"])
        shown = [{k: v for k, v in row.items() if k != "cumulative"} for row in rows]
        low, high = data["plan"]["band"]
        title = f"Velocity power, band {low:g} to {high:g} Hz"
        sections.append((title, [table(shown), figure(drawn, out, "power")]))
    if "twin" in data:
        found = data["twin"]
        blocks = [table(found["tail"]), table(found["servo"]), table(_swims(found["swims"]))]
        blocks += [image(path) for path in fresh_recordings.draw(out / "twin", twin)]
        blocks += _speeds(found, out)
        sections.append(("The twin beside fresh recordings", blocks))
    return [*sections, ("Where this comes from", [_provenance(data)])]


def _speeds(found: dict[str, Any], out: Path) -> list[str]:
    """Twin and plant at any beat; folders of before have none."""
    if "speeds" not in found:
        return []
    for end in (".svg", ".png"):
        figures.speed_map(found["speeds"], out / "figures" / f"speeds{end}", overwrite=True)
    return [image(out / "figures" / "speeds.svg")]


def _swims(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    names = ("recording", "beat_frequency", "measured_speed", "predicted_speed")
    more = ("position_error_share", "heading_error_deg")
    return [{name: row.get(name) for name in (*names, *more)} for row in rows]


def _warnings(data: dict[str, Any]) -> str:
    cut = data["cut_short"]
    if not cut:
        return ""
    return f"<p class='warn'>Cut short, read up to their ends: {escape(', '.join(cut))}.</p>"


def _reach(out: Path, data: dict[str, Any], fish: Fish) -> list[Section]:
    blocks: list[str] = []
    for name, row in data["reach"].items():
        count = data["plan"]["arms"][name]
        swims, _ = runs.load(out, name, -(-count // CHUNK))
        stem = name.replace(" ", "-")
        blocks += [f"<h3>{escape(name)}</h3>", table([_reach_row(row)])]
        blocks.append(figure(swim_figures.reach_map(swims, name), out, f"{stem}-map"))
        if not name.endswith("twin"):
            blocks.append(figure(swim_figures.paths(swims, fish), out, f"{stem}-paths"))
            blocks.append(figure(swim_figures.gaits(swims), out, f"{stem}-gaits"))
    if data["reach"]:
        blocks.insert(0, figure(swim_figures.sectors(data["reach"]), out, "reach-sectors"))
        return [("Reaching", blocks)]
    return []


def _reach_row(row: dict[str, Any]) -> dict[str, Any]:
    trained = row["trained range"] or {}
    return {
        "swims": row["swims"],
        "5 cm": _share(row, "5cm"),
        "20 cm": _share(row, "20cm"),
        "±120°, to 2.5 m: 5 cm": _share(trained, "5cm"),
        "±120°, to 2.5 m: 20 cm": _share(trained, "20cm"),
        "median time [s]": row["median_seconds"],
        "way over distance": row["median_path_ratio"],
    }


def _share(row: dict[str, Any], key: str) -> str:
    if f"within_{key}" not in row:
        return "-"
    low, high = row[f"interval_{key}"]
    return f"{100 * row[f'within_{key}']:.1f} % ({100 * low:.1f}–{100 * high:.1f})"


def beside_paper(data: dict[str, Any]) -> list[dict[str, Any]]:
    """The paper's figures and ours, a row each."""
    open_water = data["reach"].get("reach open")
    ours: dict[str, str] = {}
    if open_water:
        trained = open_water["trained range"] or {}
        ours["static targets within 5 cm"] = _share(trained, "5cm")
        ours["static targets within 20 cm"] = _share(trained, "20cm")
        lateral = [r for r in open_water["sectors"] if r["bearing [deg]"] == "90-120"]
        ours["lateral rear, 90-120°, within 20 cm"] = _share(lateral[0], "20cm") if lateral else "-"
    disturbed = data.get("disturb", [])[1:]
    for key in ("5cm", "20cm"):
        found = [f"{100 * row[f'within_{key}']:.0f}" for row in disturbed]
        names = ", ".join(row["arm"].removeprefix("disturb ") for row in disturbed)
        label = f"perturbed targets within {key.removesuffix('cm')} cm"
        ours[label] = f"{', '.join(found)} % ({names})" if found else "-"
    crossed = {
        row["arm"]: f"{row['two_crossings']} of {row['swims']}" for row in data.get("track", [])
    }
    if crossed:
        name = "figure-eight, 73 s: two clean crossings"
        ours[name] = f"{crossed[track.EIGHT]} by the clock, {crossed[track.LED_EIGHT]} led"
    below = "velocity power below the edge: "
    labels = {"identification": "identification runs", "reach twin": "policy in its twin"}
    labels["reach open"] = "deployed"
    for row in data["spectrum"]:
        if row["gait"] == "all" and row["runs"] in labels and row["share_below"] is not None:
            ours[below + labels[row["runs"]]] = f"{100 * row['share_below']:.0f} %"
    return [{"": name, "paper": text, "here": ours.get(name, "-")} for name, text in PAPER.items()]


def _provenance(data: dict[str, Any]) -> str:
    plan = {k: v for k, v in data["plan"].items() if k not in ("arms", "training")}
    training = {f"training {k}": v for k, v in data["plan"]["training"].items()}
    return table(
        [{"": k, "value": v} for k, v in {**data["provenance"], **plan, **training}.items()]
    )


# ---- a comparison -------------------------------------------------------------------------------


def compared(out: Path, data: dict[str, Any]) -> list[Section]:
    """Sections of a comparison."""
    rows = data["rows"]
    drawn = figure(swim_figures.transfer(data["kinds"]), out, "transfer")
    return [
        ("Gap between twin and pool", [drawn, table(_plain(data["kinds"]))]),
        ("Every policy in every water", [table(_plain(rows))]),
        (
            "Where this comes from",
            [table([{"": k, "value": v} for k, v in data["provenance"].items()])],
        ),
    ]


# ---- HTML ---------------------------------------------------------------------------------------


def figure(drawn: Figure, out: Path, name: str) -> str:
    """A figure saved in `figures/` and put into the page."""
    return image(swim_figures.save(drawn, out / "figures" / name)[0])


def image(path: Path) -> str:
    """A drawn SVG inside the page."""
    text = base64.b64encode(path.read_bytes()).decode()
    return f"<p><img alt='{escape(path.stem)}' src='data:image/svg+xml;base64,{text}'></p>"


def video(path: Path) -> str:
    """A film inside the page."""
    text = base64.b64encode(path.read_bytes()).decode()
    return f"<p><video controls loop src='data:video/mp4;base64,{text}'></video></p>"


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Rows as an HTML table."""
    if not rows:
        return ""
    head = "".join(f"<th>{escape(str(name))}</th>" for name in rows[0])
    lines = (
        "<tr>" + "".join(f"<td>{escape(_cell(row.get(name)))}</td>" for name in rows[0]) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def _plain(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Nested differences as one cell."""
    return [
        {name: _gap(value) if isinstance(value, dict) else value for name, value in row.items()}
        for row in rows
    ]


def _gap(value: dict[str, Any]) -> str:
    low, high = value["interval"]
    return f"{100 * value['difference']:+.1f} ({100 * low:+.1f} … {100 * high:+.1f})"


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, list | tuple):
        return " … ".join(_cell(one) for one in value)
    if isinstance(value, dict):
        return ", ".join(f"{k} {v}" for k, v in value.items())
    return str(value)
