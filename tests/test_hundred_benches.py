"""How often intervals of tail and servo hold the truth, counted over a hundred virtual benches:
as many fish, of all sizes, whose servos differ from the catalogue's. Slow: an hour on a core."""

import json
import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.evaluate.zoo import SERVO, UNITS, animals, guess
from tailbeat.evaluate.zoo_run import intervals_hold
from tailbeat.fish.first_draft import FIRST, _band
from tailbeat.fish.proportions import sketch
from tailbeat.fish.sketch_file import text_of
from tailbeat.fish.store import load_fish, write_identified
from tailbeat.identify import chain, stages
from tailbeat.identify.job import FluidConfig
from tailbeat.identify.protocol import HELD_OUT_SERVO
from tailbeat.pool.record import record
from tailbeat.report.identified import DRAWINGS

PER_ZOO = 7  # the eighth is the crank fish, for which there is no bench
BENCHES = range(int(os.environ.get("TAILBEAT_BENCHES", "100")))
SPREAD, DELAYS = 0.2, (0.008, 0.022)  # of the servos' logarithms; s


def a_lab(number: int, folder: Path) -> tuple[Path, Path]:
    """A fish in the pool and what its user believes of it."""
    rng = np.random.default_rng([number, 61])
    given = animals(number // PER_ZOO)[number % PER_ZOO].given
    drawn, lab = folder / "drawn.toml", folder / "lab.toml"
    assert given is not None
    made = sketch(given)
    drawn.write_text(text_of("drawn", replace(made, band=_band(made)), FIRST, 0.0))
    fish = load_fish(drawn)
    values = {
        name: getattr(fish.servos[fish.servo], name) * np.exp(SPREAD * rng.normal())
        for name in SERVO
    } | {"delay": rng.uniform(*DELAYS)}
    write_identified(drawn, lab, {
        f"servos.{fish.servo}.{name}": {
            "value": float(value), "unit": UNITS[name], "source": "drawn for this test"
        }
        for name, value in values.items()
    }, "")  # fmt: skip
    guess(lab, folder / "guess.toml", number)
    return lab, folder / "guess.toml"


def counted(number: int, folder: Path) -> dict[str, bool]:
    """Of each number called decided, whether its interval holds the truth."""
    folder.mkdir()
    lab, first = a_lab(number, folder)
    tail, servo = (record(kind, str(lab), folder / "data", number) for kind in ("tail", "servo"))
    found = {path.stem: path for path in (*tail, *servo)}
    held = [found[name] for name in HELD_OUT_SERVO]
    data = chain.Folder(
        [found["tail-sweep"]], found["tail-static"], None,
        [path for path in servo if path not in held], held, [], [], [],
    )  # fmt: skip
    places = {name: folder / name / "mine.toml" for name in ("tail", "servo")}
    chain._run_tail_and_servo(
        str(first), data, places, FluidConfig(seeds=1), lambda *_: None,
        DRAWINGS, None,
    )  # fmt: skip
    return intervals_hold(lab, places["servo"])


@pytest.mark.slow
def test_decided_numbers_of_a_hundred_benches_lie_in_their_intervals(tmp_path, monkeypatch):
    """Delays too. Neither the step, which costs ten seconds, nor figures are made."""
    monkeypatch.setattr(stages, "_reported", lambda paths, values, report, draw: values)
    held, decided = Counter[str](), Counter[str]()
    for number in BENCHES:
        one = counted(number, tmp_path / str(number))
        decided.update(one.keys())
        held.update(name for name, inside in one.items() if inside)
        print(number, json.dumps(one), f"{held.total()} of {decided.total()}", flush=True)
    shares = {name: held[name] / decided[name] for name in decided}
    print({name: f"{held[name]} of {decided[name]}" for name in decided})
    assert decided.total() >= 4 * len(BENCHES)  # a fit that decides nothing would hold everything
    assert held.total() >= 0.9 * decided.total()
    assert min(shares.values()) >= 0.85, shares
