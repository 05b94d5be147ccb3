"""A posterior lies beside its fish and no other; its bands hold as often as they say."""

import json
from dataclasses import replace

import numpy as np
import pytest

from support import tailbeat
from synthetic import record
from tailbeat.files import BadInput
from tailbeat.fish.description import COEFFICIENTS
from tailbeat.fish.store import digest, fish_path, load_fish, value_at
from tailbeat.identify import bands as banded
from tailbeat.identify import posterior as store
from tailbeat.identify.bands import (
    TRANSFER,
    Deviation,
    Discrepancy,
    Drawn,
    bands,
    count,
    discrepancy,
)
from tailbeat.identify.posterior import Posterior, coefficient_factors
from tailbeat.identify.quantities import UNITS
from tailbeat.identify.runs import as_run
from tailbeat.recording import write_recording

FISH = load_fish("pulley-fish")
RUN = as_run(record(FISH, "a", 1.5, 0.5, seconds=3.0), FISH)
ONE, TWO = Deviation(0.9, 0.02, 0.05, 12), Deviation(1.0, 0.05, 1.5, 9)
USUAL = 0.3  # m/s
KNOWN = Discrepancy(ONE, ONE, TWO, TWO, 12, USUAL)


def posterior(fish=FISH, **changes) -> Posterior:
    blunt = np.linspace(0.9, 1.1, 5) * fish.zones["fin"].blunt
    found = Posterior(
        fish.name, digest(fish), ("zones.fin.blunt",), ("1",), blunt[:, None], ("a", "b"), ("c",),
        KNOWN,
    )  # fmt: skip
    return replace(found, **changes)


def test_what_is_written_is_read_again(tmp_path):
    path = store.beside(tmp_path / "my-fish.toml")
    assert path.name == "my-fish-posterior.parquet"
    store.write(path, posterior())
    found = store.read(path)
    for name in ("fish", "fish_digest", "paths", "units", "fitted", "held_out", "discrepancy"):
        assert getattr(found, name) == getattr(posterior(), name), name
    assert np.array_equal(found.draws, posterior().draws)
    assert "mujoco" in found.versions and "tailbeat" in found.versions
    with pytest.raises(BadInput, match="exists already"):
        store.write(path, posterior())


def test_each_draw_is_a_fish_with_its_numbers():
    drawn = store.fishes(FISH, posterior(), most=3)
    assert [f.zones["fin"].blunt for f in drawn] == pytest.approx(posterior().draws[:3, 0])
    other = next(name for name in FISH.zones if name != "fin")
    assert drawn[0].zones[other] == FISH.zones[other]


def test_another_fish_s_posterior_is_refused():
    other = FISH.model_copy(update={"added_inertia": 0.5})
    with pytest.raises(BadInput, match=r"the posterior is of pulley-fish .*identify it again"):
        store.fishes(other, posterior())


def test_a_discrepancy_of_earlier_releases_is_left_out(tmp_path, monkeypatch):
    """Its numbers were of another size, and would make bands too narrow."""
    path = tmp_path / "f-posterior.parquet"
    old = {"speed": 0.05, "distance": 0.05, "heading": 0.1, "turn_rate": 0.1, "swims": 12}
    monkeypatch.setattr(store, "asdict", lambda known: {**old, "told": None, "steady": None})
    store.write(path, posterior())
    assert store.read(path).discrepancy is None


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda path: path.write_text("time_s,angle\n0,1\n"), "not a Parquet file"),
        (lambda path: path.unlink(), "no such file"),
        (lambda path: write_recording(*plain_table(path)), "not a posterior"),
        (lambda path: rewrite(path, draws=np.full((2, 1), np.nan)), "not finite"),
        (lambda path: rewrite(path, draws=np.empty((0, 1))), "no draw"),
        (lambda path: rewrite(path, units=("1", "m")), "not a posterior"),
    ],
)
def test_a_file_that_is_no_posterior_is_refused(tmp_path, spoil, said):
    path = tmp_path / "f-posterior.parquet"
    store.write(path, posterior())
    spoil(path)
    with pytest.raises(BadInput, match=said):
        store.read(path)


def plain_table(path):
    path.unlink()
    return record(FISH, "a", 1.5, 0.5, seconds=1.0), path


def rewrite(path, **changes):
    path.unlink()
    store.write(path, posterior(**changes))


# ---- bands --------------------------------------------------------------------------------------


LEFT = np.array([0.05, 0.05, 2.0, 2.0])  # in sizes of a swim


def swims(
    number: int, seed: int, factor: float | np.ndarray = 1.0, left: float = 1.0
) -> list[Drawn]:
    """Swims in water in which all is `factor` times as large as in the twin, with `left` times
    `LEFT` beyond draws of 1 % of a usual swim."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(number):
        predicted = np.array([0.3, 4.0, rng.uniform(-90, 90), rng.uniform(-20, 20)])
        draws = predicted + 0.01 * np.array([0.3, 4.0, 60.0, 10.0]) * rng.normal(size=(64, 4))
        draws[0] = predicted  # the fish
        swum = Drawn(RUN, predicted, draws)
        error = np.hypot(left * LEFT * banded.size(swum, USUAL), factor * swum.spread) * rng.normal(
            size=4
        )
        made.append(replace(swum, measured=factor * predicted + error))
    return made


@pytest.mark.parametrize("factor", [1.0, 0.7, 1.4])
def test_the_discrepancy_is_a_factor_and_what_the_draws_do_not_explain(factor):
    found = discrepancy(swims(400, 0, factor))
    for one, left in zip(found.all, LEFT, strict=True):
        assert one.left == pytest.approx(left, rel=0.15)
        assert abs(one.factor - factor) < 3 * one.error < 0.03
    exact = discrepancy([replace(one, measured=one.centre) for one in swims(20, 1)])
    assert max(one.left for one in exact.all) == 0.0
    assert [one.factor for one in exact.all] == pytest.approx([1.0] * 4)


def test_a_factor_is_followed_as_far_as_swims_tell_it():
    """One swim whose draws are as wide as its error tells nothing of the water."""
    (one,) = swims(1, 0)
    wide = replace(one, predicted=one.centre * np.linspace(1.0, 5.0, 64)[:, None])
    told = discrepancy([replace(wide, measured=1.3 * wide.centre)]).speed
    assert 1.0 < told.factor < 1.02 and told.error == pytest.approx(banded.FACTOR, rel=0.05)
    many = discrepancy([replace(o, measured=1.3 * o.centre) for o in swims(20, 1)]).speed
    assert many.factor == pytest.approx(1.3, abs=0.001)


@pytest.mark.thorough
@pytest.mark.parametrize("held_out", [4, 8, 13])
def test_bands_hold_95_percent_of_fresh_swims(held_out):
    """However few swims told the water. Two naive bands stand beside them: draws alone, which hold
    a third, and bands as wide as the factor is off, which are wider."""
    inside, alone, width, plain = [], [], [], []
    rng = np.random.default_rng(held_out)
    for seed in range(150):
        factor = 1 + 0.25 * rng.normal()
        known = discrepancy(swims(held_out, seed, factor))
        kind = np.array(list(TRANSFER.values()))
        other = factor + kind * rng.normal()  # of another kind of swims
        for fresh in swims(4, 1000 + seed, other):
            found = bands(fresh, known)
            inside += [band.inside for band in found]
            alone += [band.inside for band in bands(fresh, None)]
            width.append(found[0].high - found[0].low)
            plain.append(2 * 2.2 * abs(factor - 1) * fresh.centre[0])
    assert 0.92 <= np.mean(inside) <= 0.99
    assert np.mean(alone) < 0.5
    assert np.mean(width) < 0.8 * np.mean(plain)


def test_what_a_draw_has_wrong_in_every_swim_is_left_to_the_factor():
    """Draws scattered by 2 % and bands counted it, though all but a tenth of it was one factor. One
    swim cannot tell which it is."""
    rng = np.random.default_rng(0)
    alike, apart = 1 + 0.02 * rng.normal(size=64), 1 + 0.002 * rng.normal(size=(12, 64))
    drawn = 0.3 * alike * apart
    drawn[3], drawn[5, 7] = np.nan, np.inf  # a cruise has no distance; one draw diverged
    assert banded.own_share(drawn) == pytest.approx(0.1, abs=0.02)
    assert banded.own_share(apart) == pytest.approx(1.0, abs=0.1)
    assert banded.own_share(drawn[:1]) == 1.0


def test_a_slow_swim_has_a_wider_band_for_its_speed():
    """A slow swim that turns hard errs by more than its share of the usual speed. At the usual
    speed the size is the speed itself."""
    (usual,) = swims(1, 0)
    slow = replace(usual, predicted=usual.predicted / [3, 3, 1, 1])
    sizes = [banded.size(one, USUAL)[:2] for one in (usual, slow)]
    assert sizes[0] == pytest.approx(usual.centre[:2])
    assert sizes[1] / sizes[0] == pytest.approx([np.hypot(1, 1 / 3) / 2**0.5] * 2)


def test_a_quantity_that_few_swims_told_has_wider_bands_and_one_that_none_told_has_none():
    """It got a band of the draws alone, which hold a third, or as narrow as if all had told it."""
    blind = np.array([0, 0, np.nan, 0])
    (fresh,), told = swims(1, 9), swims(10, 0)
    some = discrepancy([*told[:2], *(replace(o, measured=o.measured + blind) for o in told[2:])])
    assert [one.swims for one in some.all] == [10, 10, 2, 10]
    as_told = replace(some, heading=replace(some.heading, swims=10))
    wide, usual = (
        {b.quantity: b.high - b.low for b in bands(fresh, known)} for known in (some, as_told)
    )
    ratio = {name: wide[name] / usual[name] for name in wide}
    assert ratio.pop("heading") == pytest.approx(12.706 / 2.262, rel=1e-3)  # Student's t, 1 and 9
    assert list(ratio.values()) == pytest.approx([1.0] * 3)
    none = discrepancy([replace(one, measured=one.measured + blind) for one in told])
    assert [b.quantity for b in bands(fresh, none)] == ["speed", "distance", "turn_rate"]


def test_a_band_is_about_the_fish_where_its_draws_lie_on_one_side():
    """A number at an end of its range moves all its draws one way, and a band about their median
    would leave out the fish's own prediction. They scatter less than draws on both sides: half a
    normal distribution has 0.60 of its deviation. Moving all of them alike changes nothing."""
    (swum,) = swims(1, 0)
    aside = swum.centre + np.abs(swum.predicted - swum.centre)
    (band, *_) = bands(replace(swum, predicted=aside), None)
    (same, *_) = bands(swum, None)
    assert (band.low + band.high) / 2 == band.predicted == swum.predicted[0, 0]
    share = (band.high - band.low) / (same.high - same.low)
    assert share == pytest.approx(0.6, abs=0.1)
    moved = replace(swum, predicted=np.vstack([swum.centre, aside[1:] + 3.0]))
    (far, *_) = bands(moved, None)
    assert far.high - far.low == pytest.approx(band.high - band.low, rel=0.1)


def test_a_draw_that_diverged_does_not_widen_a_band_and_many_make_it_endless():
    (swum,) = swims(1, 0)
    one, most = swum.predicted.copy(), swum.predicted.copy()
    one[5], most[:40] = np.inf, np.inf
    was, with_one, with_most = (
        bands(replace(swum, predicted=p), None)[0] for p in (swum.predicted, one, most)
    )
    assert with_one.high - with_one.low == pytest.approx(was.high - was.low, rel=0.1)
    assert np.isinf(with_most.high - with_most.low)


@pytest.mark.parametrize("lost", [40, 64])
def test_a_check_swim_in_which_most_draws_diverged_tells_nothing(lost):
    *told, spoilt = swims(12, 0)
    spoilt.predicted[:lost] = np.inf
    with_it, without = discrepancy([*told, spoilt]), discrepancy(told)
    for one, other in zip(with_it.all, without.all, strict=True):
        assert one.swims == 11 and one.own == pytest.approx(other.own)
        assert (one.factor, one.left) == pytest.approx((other.factor, other.left), rel=0.01)


def test_bands_are_counted_by_quantity():
    found = [band for one in swims(50, 3) for band in bands(one, KNOWN)]
    rows = {row.quantity: row for row in count(found)}
    assert list(rows) == list(UNITS)
    for row in rows.values():
        own = [band for band in found if band.quantity == row.quantity]
        assert row.swims == 50 and row.inside == sum(b.low <= b.measured <= b.high for b in own)


def test_the_twin_s_own_swim_lies_in_its_bands_and_a_faster_one_does_not():
    """The recording is the fish's own, so the first draw predicts it but for the camera."""
    fishes = store.fishes(FISH, posterior())
    (swum,) = banded.swim_all(fishes, [RUN])
    assert swum.predicted[2] == pytest.approx(swum.measured, rel=0.02, abs=1.5)
    assert all(band.inside for band in bands(swum, KNOWN) if band.quantity != "turn_rate")
    fast = replace(swum, measured=2 * swum.measured)
    assert not any(
        band.inside for band in bands(fast, KNOWN) if band.quantity in ("speed", "distance")
    )


def test_a_swim_without_heading_has_bands_of_speed_and_distance_alone():
    blind = replace(RUN, track=replace(RUN.track, pose=RUN.track.pose * [1, 1, np.nan]))
    (swum,) = banded.swim_all(store.fishes(FISH, posterior()), [blind])
    assert [band.quantity for band in bands(swum, None)] == ["speed", "distance"]


def test_predict_gives_bands_from_the_posterior_beside_the_fish(tmp_path):
    fish, out = my_fish(tmp_path), tmp_path / "out.json"
    own = load_fish(fish)
    store.write(store.beside(fish), posterior(own))
    write_recording(record(own, "swim", 1.5, 0.5, seconds=3.0), tmp_path / "swim.csv")
    done = tailbeat("predict", "--fish", fish, tmp_path / "swim.csv", "--json", out)
    assert done.returncode == 0, done.stderr
    assert "speed: 1 of 1 swims inside" in done.stdout
    said = json.loads(out.read_text())
    assert [row["quantity"] for row in said["bands"]] == list(UNITS)
    assert {row["quantity"]: row["inside"] for row in said["held"]}["speed"] == 1


@pytest.mark.thorough
def test_check_swims_fit_the_bands_to_another_water(tmp_path):
    """In water in which every way is 1.3 times as long: without them no band holds."""
    fish = my_fish(tmp_path)
    own, paths = load_fish(fish), []
    known = Deviation(1.0, 0.01, 0.01, 12)
    turned = replace(known, left=0.5)
    tight = Discrepancy(known, known, turned, turned, 12, usual=0.3)
    store.write(store.beside(fish), posterior(own, discrepancy=tight))
    for number, beat in enumerate((1.5, 1.3, 1.7, 2.0)):
        swim = record(own, f"swim-{number}", beat, 0.5, seconds=3.0)
        columns = {k: 1.3 * v if k in ("x_m", "y_m") else v for k, v in swim.columns.items()}
        paths.append(tmp_path / f"swim-{number}.csv")
        write_recording(replace(swim, columns=columns), paths[-1])
    told = {}
    for name, more in (("without", ()), ("with", ("--check", *paths[1:]))):
        out = tmp_path / f"{name}.json"
        done = tailbeat("predict", "--fish", fish, paths[0], *more, "--json", out)
        assert done.returncode == 0, done.stderr
        told[name] = {row["quantity"]: row for row in json.loads(out.read_text())["bands"]}
    assert "by 3 check swims" in done.stdout
    assert json.loads(out.read_text())["discrepancy"]["distance"]["factor"] == pytest.approx(
        1.3, rel=0.02
    )
    for name in ("speed", "distance"):
        assert told["with"][name]["inside"] and not told["without"][name]["inside"]


def test_without_a_discrepancy_there_are_no_bands_and_it_says_so(tmp_path):
    """Draws alone hold a third of the swims."""
    fish = my_fish(tmp_path)
    store.write(store.beside(fish), posterior(load_fish(fish), discrepancy=None))
    write_recording(record(load_fish(fish), "swim", 1.5, 0.5, seconds=3.0), tmp_path / "swim.csv")
    done = tailbeat("predict", "--fish", fish, tmp_path / "swim.csv")
    assert done.returncode == 0 and "no 95 % bands" in done.stdout and "--check" in done.stdout


def test_predict_refuses_the_posterior_of_another_fish(tmp_path):
    store.write(tmp_path / "p.parquet", posterior())
    write_recording(record(FISH, "swim", 1.5, 0.5, seconds=3.0), tmp_path / "swim.csv")
    done = tailbeat(
        "predict", "--fish", "pulley-fish-pool", tmp_path / "swim.csv",
        "--posterior", tmp_path / "p.parquet", "--json", tmp_path / "out.json",
    )  # fmt: skip
    assert done.returncode == 2 and "the posterior is of pulley-fish" in done.stderr
    assert not (tmp_path / "out.json").exists()


@pytest.mark.thorough
def test_show_warns_of_the_posterior_of_numbers_that_were_changed(tmp_path):
    fish = my_fish(tmp_path)
    store.write(store.beside(fish), posterior())
    done = tailbeat("show", fish, "--picture", tmp_path / "fish.png")
    assert done.returncode == 0 and "warning: the posterior is of pulley-fish" in done.stdout
    assert "identified numbers" not in done.stdout


def my_fish(folder):
    """A fish of one's own, without a posterior."""
    text = fish_path("pulley-fish").read_text(encoding="utf-8")
    (folder / "my.toml").write_text(text.replace('name = "pulley-fish"', 'name = "my"'))
    return folder / "my.toml"


def test_the_shipped_posterior_belongs_to_the_shipped_fish():
    known, fish = store.of("pulley-fish-pool"), load_fish("pulley-fish-pool")
    assert known is not None and known.draws.shape == (100, len(known.paths))
    for path, value in zip(known.paths, known.draws[0], strict=True):
        assert value == pytest.approx(value_at(fish, path), rel=5e-6), path
    assert known.discrepancy is not None and known.discrepancy.swims == 15
    assert all(name.startswith("check-") for name in known.held_out)
    assert not {*known.fitted} & {*known.held_out}


def test_draws_become_factors_of_each_zone_s_own_coefficients():
    blunt = coefficient_factors(FISH, posterior())
    fin, kind = list(FISH.zones).index("fin"), COEFFICIENTS.index("blunt")
    assert blunt[:, fin, kind] == pytest.approx(posterior().draws[:, 0] / posterior().draws[0, 0])
    blunt[:, fin, kind] = 1.0
    assert (blunt == 1.0).all()
    every = coefficient_factors(FISH, posterior(paths=("zones.*.blunt",)))
    assert (every[:, :, kind] == every[:, :1, kind]).all() and np.ptp(every[:, 0, kind]) > 0


def test_training_on_a_posterior_needs_one(tmp_path):
    fish = my_fish(tmp_path)
    words = ("train", "--fish", fish, "--out", tmp_path / "run", "--physics", "posterior")
    done = tailbeat(*words)
    assert done.returncode == 2 and "tailbeat identify posterior" in done.stderr
    assert not (tmp_path / "run").exists()


@pytest.mark.thorough
def test_show_prints_what_the_recordings_decide(tmp_path):
    done = tailbeat("show", "pulley-fish-pool", "--picture", tmp_path / "fish.png")
    assert done.returncode == 0, done.stderr
    assert "identified numbers" in done.stdout and "zones.fin.kutta" in done.stdout
