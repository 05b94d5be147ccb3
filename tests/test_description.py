"""Descriptions: shipped ones load, every number can change, bad ones are refused by name."""

import tomllib

import pytest

from tailbeat.evaluate.open_loop import beat, summary
from tailbeat.files import BadInput
from tailbeat.fish.description import Uncertain
from tailbeat.fish.store import (
    Entry,
    fish_path,
    load_fish,
    new_fish,
    shipped,
    value_at,
    with_values,
    write_identified,
)
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify.fluid import fluid_space
from tailbeat.pool.chain import build_chain
from tailbeat.pool.water import Water, fingerprint

PULLEY = "pulley-fish"
FISH = load_fish(PULLEY)


def changed(tmp_path, old: str, new: str, fish: str = PULLEY):
    text = fish_path(fish).read_text()
    assert old in text
    path = tmp_path / "f.toml"
    path.write_text(text.replace(old, new, 1))
    return path


def test_the_fish_ship():
    assert shipped() == ["crank-fish", "pulley-fish", "pulley-fish-pool"]


def test_the_pool_s_fish_says_where_it_comes_from():
    text = fish_path("pulley-fish-pool").read_text()
    assert f"water {fingerprint([Water()])}" in text and "identify all" in text
    assert load_fish("pulley-fish-pool").servo == "identified"


@pytest.mark.parametrize("name", ["crank-fish", "pulley-fish"])
def test_every_number_of_a_shipped_fish_has_a_unit(name):
    """Bare numbers are left to coefficients, ratios and the SI ranges of [[uncertain]]."""
    bare = set()

    def walk(node, path=()):
        if isinstance(node, dict):
            for key, item in node.items():
                walk(item, (*path, key))
        elif isinstance(node, list):
            for item in node:
                walk(item, path)
        elif isinstance(node, int | float) and not isinstance(node, bool):
            bare.add(path)

    walk(tomllib.loads(fish_path(name).read_text()))
    free = {p for p in bare if p[0] in ("zones", "uncertain", "added_inertia", "added_along")}
    rest = {p for p in bare - free if p[-1] not in ("value", "body")}
    registers = {("hardware", "number"), ("hardware", "gain")}
    assert rest <= {("tail", "stiffness_scale"), *registers}


def test_texts_tables_and_bare_numbers_mean_the_same(tmp_path):
    line = 'radius = { value = 17.5, unit = "mm", source = "paper" }'
    for new in ('radius = "17.5 mm"', 'radius = "1.75 cm"', "radius = 0.0175"):
        assert load_fish(changed(tmp_path, line, new)).motor.radius == pytest.approx(0.0175)


BAD = {
    "unknown field": (
        'kind = "pulley"',
        'kind = "pulley"\ncolour = 3',
        "unknown field motor.colour",
    ),
    "unknown unit": ('"-80 80 deg"', '"-80 80 grad"', "unit 'grad' is not one of rad, deg"),
    "missing field": ('kind = "pulley"', "", "field motor.kind is missing"),
    "wrong kind": ('kind = "pulley"', 'kind = "winch"', "motor.kind = 'winch'"),
    "no number": ('"-80 80 deg"', '"wide"', "motor.range = 'wide'"),
    "nan": ('"1000 kg/m^3"', "nan", "medium.density"),
    "below zero": ("kutta = 0.521", "kutta = -1", "zones.head.kutta = -1"),
    "unknown zone": ('zone = "fin"', 'zone = "wing"', "names zone 'wing'"),
    "unknown servo": ('servo = "identified"', 'servo = "best"', "servo 'best' is not one of"),
    "hinge order": ('hinge = "-245 mm"', 'hinge = "-205 mm"', "hinges must run from the head"),
    "a hinge behind the fish": (
        'hinge = "-335 mm"',
        'hinge = "-2 m"',
        "tail.links.4.hinge is x = -2 m, and all parts are between -0.42 and 0.12 m",
    ),
    "a hinge ahead of the fish": (
        'hinge = "-215 mm"',
        'hinge = "0.5 m"',
        "tail.links.0.hinge is x = 0.5 m",
    ),
    "a tag far ahead": ('tracked = "40 0', 'tracked = "3000 0', "tracked is x = 3, y = 0 m, and"),
    "a marker far beside": ('"0 0 60 mm"', '"0 -600 60 mm"', "markers.1.position is x = 0, y = -"),
    "band": ('band = "1 4 Hz"', 'band = "4 1 Hz"', "band [4.0, 1.0]"),
    "a step that is no part of 20 ms": (
        'step = "4 ms"',
        'step = "3 ms"',
        "simulation.step = '3 ms': the step must divide the 20 ms of the robot's loop, as 1, 2",
    ),
    "a long step": ('step = "4 ms"', 'step = "15 ms"', "simulation.step = '15 ms': the step must"),
    "a part's name twice": ('name = "tail1"', 'name = "tail0"', "part 'tail0' stands there twice"),
    "a range that falls": ('"-80 80 deg"', '"80 -80 deg"', "motor.range must rise"),
    "no stiffness": (
        "k_eff = { value = 0.98",
        "k_eff = { value = 0",
        "tail.k_eff",
    ),
    "inertias of no body": (
        "[head]",
        '[head]\ninertial = { mass = "1 kg", centre = "0 0 0 mm", inertia = "1 1 3 kg m^2" }',
        "no larger than the other two sum",
    ),
    "not TOML": ("[motor]", "[motor", "not valid TOML"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_descriptions_are_one_sentence(tmp_path, case):
    old, new, complaint = BAD[case]
    with pytest.raises(BadInput) as caught:
        load_fish(changed(tmp_path, old, new))
    message = str(caught.value)
    assert complaint in message and "f.toml" in message and "\n" not in message


def test_a_fish_that_the_engine_refuses_is_one_sentence(tmp_path):
    mesh = '[head]\nmesh = { file = "nowhere.stl" }'
    fish = load_fish(changed(tmp_path, "[head]", mesh))
    with pytest.raises(BadInput, match=r"the engine refuses it: .*nowhere\.stl"):
        compile_twin(fish, Options(looks=True))


@pytest.mark.parametrize(
    ("field", "low", "said"),
    [
        ("tendons.slak", 0.1, "uncertain field 'tendons.slak' is no number of the fish"),
        ("tag", 0.1, "uncertain field 'tag' is no number of the fish"),
        ("tail.friction", 0.0, "is searched by its logarithm"),
    ],
)
def test_an_uncertain_field_must_be_a_number_that_can_be_searched(field, low, said):
    listed = Uncertain(field=field, unit="1", low=low, high=1.0, spread=0.5)
    with pytest.raises(BadInput, match=said):
        fluid_space(load_fish(PULLEY).model_copy(update={"uncertain": (listed,)}), 1)


def test_values_are_set_by_path_and_checked():
    fish = load_fish(PULLEY)
    other = with_values(fish, {"zones.fin.kutta": 2.5, "tail.links.1.stiffness": 3.0})
    assert value_at(other, "zones.fin.kutta") == 2.5
    assert other.tail.links[1].stiffness == 3.0
    assert fish.zones["fin"].kutta == 10.148
    with pytest.raises(BadInput, match=r"no field zones\.fin\.lift"):
        with_values(fish, {"zones.fin.lift": 1.0})
    with pytest.raises(BadInput, match=r"zones\.fin\.kutta = -1"):
        with_values(fish, {"zones.fin.kutta": -1.0})


def test_identified_fish_keeps_comments_and_records_where_from(tmp_path):
    entry: Entry = {"value": 1.25, "unit": "1", "interval": [1.0, 1.5], "source": "identified on a"}
    target = tmp_path / "id.toml"
    write_identified(PULLEY, target, {"zones.fin.kutta": entry}, "made by a test")
    text = target.read_text()
    assert text.startswith("# made by a test\n")
    assert "# Paper's fifteen coefficients." in text and "identified on a" in text
    assert load_fish(target).zones["fin"].kutta == 1.25
    with pytest.raises(BadInput, match="exists already"):
        write_identified(PULLEY, target, {}, "again")


def test_a_field_that_the_file_lacks_is_added_where_it_belongs(tmp_path):
    new_fish(tmp_path / "mine.toml")
    entry: Entry = {"value": 1.3, "unit": "1", "source": "a test"}
    step: Entry = {"value": 1.0, "unit": "ms", "source": "t"}
    values = {"tail.stiffness_scale": entry, "added_inertia": entry, "simulation.step": step}
    write_identified(tmp_path / "mine.toml", tmp_path / "out.toml", values, "n")
    fish = load_fish(tmp_path / "out.toml")
    assert fish.tail.stiffness_scale == 1.3 and fish.added_inertia == 1.3
    assert fish.simulation.step == 0.001 and len(fish.tail.links) == 3


def test_template_is_a_fish_that_compiles_and_swims_forward(tmp_path):
    new_fish(tmp_path / "mine.toml")
    fish = load_fish(tmp_path / "mine.toml")
    assert fish.name == "mine"
    done, _ = beat(fish, 1.5)
    assert summary(done).speed_m_s > 0.005
    with pytest.raises(BadInput, match="exists already"):
        new_fish(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"tendons": {"head_guides": ()}}, "tendons.head_guides is missing"),
        ({"head": "dry"}, "no part of the head outside zone fin has a zone"),
    ],
)
def test_a_fish_that_the_plant_would_swim_otherwise_is_refused(changes, said):
    """Without the hole in the head, the first hinge had no tendon, and nobody was told."""
    parts = tuple(one.model_copy(update={"zone": None}) for one in FISH.head.parts)
    update = {
        name: FISH.head.model_copy(update={"parts": parts})
        if name == "head"
        else FISH.tendons.model_copy(update=held)
        for name, held in changes.items()
    }
    with pytest.raises(BadInput, match=said):
        build_chain(FISH.model_copy(update=update))
