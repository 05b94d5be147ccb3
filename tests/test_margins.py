"""Margins: the search finds a known size, its intervals hold it as often as they say, and a tag
glued sideways has the margin that geometry allows."""

import json
from importlib.util import find_spec

import numpy as np
import pytest

from support import complaint, tailbeat

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.cluster.margins import CellsJob, swim_cells
from tailbeat.control.policy import contract_digest, load_policy
from tailbeat.evaluate import margin_cells as cells
from tailbeat.evaluate import margins as measured
from tailbeat.evaluate.margin_cells import (
    BASES,
    FEW,
    RESTS,
    RINGS,
    Cell,
    Hits,
    bracket,
    following,
    largest,
    next_cells,
    sizes,
)
from tailbeat.evaluate.margins import (
    MarginsConfig,
    MarginsRun,
    crossing,
    lab_of,
    numbers,
)
from tailbeat.files import BadInput
from tailbeat.fish.lab import Lab
from tailbeat.fish.store import digest, fish_path, load_fish
from tailbeat.pool import mess

COUNT = 40
NAME, POLICY = "horn", "pulley-fish-pool-generator"
RUN = MarginsRun("p", "f", "d", mess.fingerprint(), COUNT, 0)


def population(rng, count, middle=8.0, spread=0.6):
    """Sizes, over the everyday one, that each target stands."""
    return middle * np.exp(spread * rng.normal(size=count))


def searched(stands, name=NAME):
    """A search with targets that each stand a size: every cell that it swims."""
    table = {base: Hits((True,) * COUNT, (True,) * COUNT) for base in BASES.values()}
    for _ in range(100):
        wanted = next_cells([name], table, COUNT)
        if not wanted:
            return table
        for cell in wanted:
            done = len(table.get(cell, Hits()).arrived)
            end = FEW if done < FEW else COUNT
            hits = tuple((stands[:end] >= cell.factor).tolist())
            table[cell] = Hits(hits, hits)
    raise AssertionError("the search does not end")


@pytest.mark.thorough
def test_the_search_finds_the_size_that_three_quarters_stand():
    """Within the fifth that a bracket leaves, plus what clear cells are known to; few cells."""
    for seed in range(20):
        stands = population(np.random.default_rng(seed), COUNT, middle=2.0 ** (seed / 4))
        table = searched(stands)
        row = numbers(table, [NAME], RUN, {}).margins[0]
        exact = np.sort(stands)[::-1][int(0.75 * COUNT) - 1]
        most = mess.BY_NAME[NAME].most
        if row.size is None:
            assert exact >= largest(NAME) / 1.3
        else:
            assert row.size / row.everyday == pytest.approx(exact, rel=0.3), seed
            assert row.interval[0] <= row.size <= (row.interval[1] or most)
        assert len(table) < 24


@pytest.mark.slow
def test_its_intervals_hold_the_population_s_size_as_often_as_they_say():
    """95 % are said; 60 policies, whose targets are drawn from a known population."""
    exact = 8.0 * np.exp(0.6 * -0.6745)  # a quarter stands less
    held = 0
    for seed in range(60):
        table = searched(population(np.random.default_rng([1, seed]), COUNT))
        low, high = numbers(table, [NAME], RUN, {}).margins[0].interval
        unit = mess.BY_NAME[NAME].everyday
        held += low <= exact * unit <= (np.inf if high is None else high)
    assert held >= 51  # fewer have a chance of 2 % if 95 % hold


def test_a_policy_that_fails_at_once_or_never_is_told_apart():
    never, always = np.zeros(COUNT), np.full(COUNT, np.inf)
    row = numbers(searched(never), [NAME], RUN, {}).margins[0]
    assert row.size is not None and row.size < 0.26 * row.everyday * 2
    row = numbers(searched(always), [NAME], RUN, {}).margins[0]
    assert row.size is None and row.interval == (row.most, None)
    assert crossing({0.0: 1.0, 2.0: 1.0, 4.0: 0.5}) == pytest.approx(2 * 2**0.5)
    assert bracket({1.0: 0.9, 2.0: 0.5, 4.0: 0.9}) == (1.0, 2.0)  # a lucky cell beyond is not used


def test_a_cell_is_one_nuisance_over_none_or_over_everyday_ones():
    everyday = mess.level("everyday")
    assert sizes(Cell("slack", "alone", 2.0)) == dict.fromkeys(everyday, 0.0) | {"slack": 6.0}
    assert sizes(Cell("slack", "everyday", 2.0)) == {**everyday, "slack": 6.0}
    assert sizes(Cell("slack", "everyday", 1e9))["slack"] == mess.BY_NAME["slack"].most
    assert sizes(BASES["everyday"]) == everyday and not any(sizes(BASES["alone"]).values())
    found = {following(NAME, rest, ring, {}, COUNT) for rest in RESTS for ring in RINGS}
    assert found == {Cell(NAME, "alone", 2.0), Cell(NAME, "everyday", 2.0)}


def test_the_lab_s_own_figures_are_read_in_any_unit_and_change_no_digest(tmp_path):
    path = tmp_path / "mine.toml"
    table = '\n[lab]\ntag_sideways = "0.4 cm"\nhorn = "2 deg"\nstiffness = "10 %"\n'
    words = ("--length", "540mm", "--mass", "1.2kg", "--hinges", "3", "--servo", "xl330")
    assert tailbeat("new-fish", path, *words).returncode == 0
    plain = load_fish(str(path))
    path.write_text(path.read_text() + table)
    own = load_fish(str(path))
    figures = {"tag sideways": 4.0, "horn": 2.0, "stiffness": 10.0}
    assert lab_of(own, "mine.toml") == pytest.approx(figures) and lab_of(plain, "mine.toml") == {}
    assert digest(own) == digest(plain)
    row = numbers(
        searched(population(np.random.default_rng(0), COUNT)), [NAME], RUN, lab_of(own, "mine.toml")
    )
    first = row.margins[0]
    assert first.size is not None
    assert first.lab == pytest.approx(2.0) and first.safety == pytest.approx(first.size / 2.0)


def test_a_figure_of_the_lab_is_at_most_what_can_be_simulated(tmp_path):
    """A number without a unit is in SI: 3 is 3 rad. Nothing is swum or written then."""
    path = tmp_path / "mine.toml"
    path.write_text(fish_path("pulley-fish").read_text() + "\n[lab]\nslack = 3\n")
    said = complaint("margins", POLICY, "--fish", path, "--out", tmp_path / "m")
    assert "lab.slack is 171.9 deg; allowed is up to 60 deg" in said and '"3 deg"' in said
    assert not (tmp_path / "m").exists()
    for name, one in mess.BY_NAME.items():
        most = f"{one.most:g} {one.unit.replace('²', '^2')}"
        lab = Lab.model_validate({name.replace(" ", "_"): most})
        found = lab_of(load_fish("pulley-fish").model_copy(update={"lab": lab}), "mine.toml")
        assert found == {name: pytest.approx(one.most)}


def test_a_nuisance_is_reported_once_and_stays_when_others_follow(tmp_path):
    policy, stands = load_policy(POLICY), population(np.random.default_rng(0), 16)

    def swim(some, table):
        hits = {cell: tuple((stands >= cell.factor).tolist()) for cell in some}
        return {cell: Hits(hit, hit) for cell, hit in hits.items()}

    def names(*asked):
        config = MarginsConfig(targets=16, nuisances=asked)
        done = measured.margins(policy, config, tmp_path / "m", lambda *_: None, swim)
        assert measured.read_margins(tmp_path / "m") == done
        return list(dict.fromkeys(row.nuisance for row in done.margins)), done

    found, done = names("slack", "tag sideways", "slack")
    assert found == ["slack", "tag sideways"] and len(done.margins) == 8
    assert sorted(done.thinnest) == found
    assert names("horn")[0] == ["horn", "slack", "tag sideways"]
    table = cells.read_cells(tmp_path / "m")
    assert cells.reported(["horn"], table, 16) == ("horn", "slack", "tag sideways")
    begun = "slack", "alone"  # without its cells
    half = {cell: hits for cell, hits in table.items() if (cell.nuisance, cell.rest) != begun}
    assert cells.reported(["horn"], half, 16) == ("horn", "tag sideways")


@pytest.mark.parametrize(
    ("held", "said"),
    [
        ('{"a": 1}', "cells.json: Input should be a valid list; repeat the command"),
        (
            '[{"cell": {"nuisance": "slack", "rest": "alone", "factor": "abc"}, "hits": {}}]',
            "cells.json: 0.cell.factor: Input should be a valid number",
        ),
        ("[", "cells.json: not readable JSON; repeat the command that wrote it, into a new folder"),
    ],
)
def test_damaged_cells_are_refused_in_one_sentence(held, said, tmp_path):
    (tmp_path / "cells.json").write_text(held)
    with pytest.raises(BadInput) as refusal:
        cells.read_cells(tmp_path)
    assert said in str(refusal.value) and "\n" not in str(refusal.value)


def measure(nuisance, folder, targets):
    """Margins of the shipped policy for one nuisance, by the command: its folder, its words and
    what it printed."""
    out = folder / "m"
    asked = ("--targets", targets, "--nuisances", nuisance)
    words = ("margins", "pulley-fish-pool-generator", "--out", out, *asked)
    done = tailbeat(*words, "--json", folder / "m.json")
    assert done.returncode == 0, done.stderr
    assert (out / "margins.png").stat().st_size > 5000
    return out, words, done.stdout


@pytest.mark.slow  # five minutes where others run beside it
def test_a_tag_glued_sideways_stands_what_geometry_allows(tmp_path):
    """A fish that puts its seen tag on the target misses with its true place by the offset: more
    than 5 cm cannot be stood much, and the wider circle stands about its own 20 cm."""
    _, _, said = measure("tag sideways", tmp_path, 16)
    assert "tag sideways: measure the tag's place" in said
    done = json.loads((tmp_path / "m.json").read_text())
    size = {(row["rest"], row["ring"]): row["size"] for row in done["margins"]}
    assert 30 < size["alone", "arrived"] < 90 and 150 < size["alone", "near"] < 350
    assert done["clean"]["arrived"] == 1.0 and done["thinnest"] == ["tag sideways"]


@pytest.mark.thorough
def test_an_interrupted_run_goes_on_to_the_same_numbers(tmp_path, monkeypatch):
    """With the last cells lost, those of the largest size; a folder of other cells is refused, and
    nothing is rewritten. Four targets, and an encoder that the policy does not read, are quick."""
    for module in (measured, cells):
        monkeypatch.setattr(module, "FEW", 4)
    out, words, _ = measure("encoder", tmp_path, 4)
    before = (out / "margins.json").read_text()
    rows = json.loads((out / "cells.json").read_text())
    doubled = [row for row in rows if np.log2(row["cell"]["factor"] or 1.0) % 1 == 0]
    assert 4 < len(doubled) < len(rows)
    (out / "cells.json").write_text(json.dumps(doubled))
    assert tailbeat(*words).returncode == 0
    assert (out / "margins.json").read_text() == before
    assert "its cells have seed 0, not 1" in complaint(*words, "--seed", 1)
    assert (out / "margins.json").read_text() == before


@pytest.mark.thorough
def test_a_cell_swum_as_a_job_of_its_own_is_the_one_swum_among_others(monkeypatch):
    """To the bit, as on a cluster (a slow test)."""
    monkeypatch.setattr(cells, "FEW", 3)
    policy, config = load_policy("pulley-fish-pool-generator"), MarginsConfig(targets=16)
    three = [BASES["everyday"], *(Cell("horn", rest, 2.0) for rest in RESTS)]
    pool = measured.pool_for(policy, config)
    table, digest = cells.swum(policy, pool, three, {}), contract_digest(policy.contract)
    for cell in three:
        job = CellsJob("pulley-fish-pool-generator", digest, config, (cell,), (Hits(),))
        assert swim_cells(job) == {cell: table[cell]}
    assert all(len(hits.arrived) == 3 for hits in table.values())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--targets", 15), "--targets 15: give 16 to 1000."),
        (("--targets", 10**8), "--targets 100000000: give 16 to 1000."),
        (("--nuisances", "hom"), "nuisance 'hom': give horn, bend,"),
        (("--fish", "crank-fish"), "crank-fish"),
        pytest.param(
            ("--address", "nowhere"),
            "--address nowhere: no Ray cluster answers",
            marks=pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed"),
        ),
    ],
)
def test_what_cannot_be_measured_is_refused_in_one_sentence(words, said, tmp_path):
    given = ("margins", "pulley-fish-pool-generator", "--out", tmp_path / "m", *words)
    assert said in complaint(*given) and not (tmp_path / "m").exists()


def test_the_config_s_defaults_are_the_command_s():
    assert MarginsConfig().targets == 40 and measured.BATCH * FEW < 1000
