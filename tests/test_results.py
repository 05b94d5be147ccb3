"""The pages of docs/results show what their JSON files hold, and nothing typed by hand."""

import json
import re
import shutil
from pathlib import Path

import pytest

import result_cells
import result_files
import result_pages
import results
from synthetic_recordings import TailTruth
from tailbeat.files import BadInput, leaves
from test_documented_commands import fault

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "results"
ENTRIES = results.read_entries(FOLDER / "commands.toml")
DATA = sorted((FOLDER / "data").glob("*.json"))
PAGES = result_pages.pages(ROOT)
RENDERER = result_pages.Renderer(ROOT)
# What may stand on a page outside its blocks: names and criteria, no results.
ALLOWED = re.compile(r"XL330|SB3|(?<!\d)(?:5|20) cm|95 % intervals?|99(?:\.9)? %|[kic]g? m²")
CODE = re.compile(r"^```.*?^```|`[^`\n]*`|\]\([^)]*\)", re.M | re.S)


def by_hand(text: str) -> list[str]:
    """Digits of a page that no expression gives: outside its blocks, and in their templates."""
    templates = "\n".join(block[1] for block in result_pages.BLOCK.finditer(text))
    plain = re.sub(r"\{\{[^}]*[a-z][^}]*\}\}|\{%.*?%\}", "", templates, flags=re.S)
    rest = result_pages.BLOCK.sub("", text) + "\n" + plain
    return re.findall(r"\S*\s?\S*\d\S*", ALLOWED.sub("", CODE.sub("", rest)))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_shows_what_its_results_hold(page):
    text = page.read_text("utf-8")
    assert RENDERER.page(text) == text, "run: make results"


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.stem)
def test_no_number_of_a_result_is_typed_by_hand(page):
    assert by_hand(page.read_text("utf-8")) == []


def test_a_number_that_is_typed_is_found():
    page = "within 5 cm <!--= {{ fix(a.b, 2) }} of 7 -->3.14 of 7<!--/--> `x 1` 2.2°"
    assert [found.strip() for found in by_hand(page)] == ["2.2°", "of 7"]


def test_templates_read_results_that_a_command_makes():
    texts = [page.read_text("utf-8") for page in PAGES]
    read = {name for text in texts for name in RENDERER.names_in(text)}
    assert read <= set(ENTRIES), read - set(ENTRIES)
    assert len(read) > 8


@pytest.mark.parametrize("path", DATA, ids=lambda path: path.stem)
def test_a_result_of_an_earlier_fish_or_policy_is_said_on_its_pages(path):
    origin = json.loads(path.read_text("utf-8"))["origin"]
    assert set(origin["files"]) == results.files(ENTRIES[path.stem])
    if not result_files.changed(origin):
        return
    told = re.compile(rf"\{{\{{ (?:made\({path.stem}\)|stale\([^)]*\b{path.stem}=)")
    texts = {page.name: page.read_text("utf-8") for page in PAGES}
    shown = {name for name, text in texts.items() if path.stem in RENDERER.names_in(text)}
    assert [name for name in shown if not told.search(texts[name])] == []


@pytest.mark.parametrize("path", DATA, ids=lambda path: path.stem)
def test_data_are_small_and_say_where_they_come_from(path):
    text = path.read_text("utf-8")
    origin, entry = json.loads(text)["origin"], ENTRIES[path.stem]
    assert origin["steps"] == list(entry.steps), "commands.toml changed: make the result again"
    assert len(origin["seconds"]) == len(entry.steps)
    assert all(origin[name] for name in ("date", "tailbeat", "commit", "machine", "processor"))
    assert len(text) < 200_000
    own = [v for v in leaves("", json.loads(text)).values() if str(v).startswith("/")]
    assert not own, "a path of the machine that made it"


@pytest.mark.parametrize("name", ENTRIES)
def test_steps_are_commands_and_files_that_exist(name):
    for step in ENTRIES[name].steps:
        plain = re.sub(r"\$\([^)]*\)", "", step)  # $(ls …) has options of its own
        assert [why for one in re.findall(r"tailbeat [^;]*", plain) if (why := fault(one))] == []
        files = re.findall(r"(?:examples|src)/\S+\.(?:csv|onnx|toml)", step)
        assert [file for file in files if not list(ROOT.glob(re.sub(r"\$\w+", "*", file)))] == []


def test_given_numbers_are_those_of_the_recordings():
    given = dict(ENTRIES["bench"].given)
    truth = TailTruth()
    assert given.pop("source")
    assert given == {name: getattr(truth, name) for name in ("k_eff", "i_eff", "c_eff", "coulomb")}


@pytest.fixture
def small(tmp_path) -> Path:
    """A repository of one page and one result."""
    folder = tmp_path / "docs" / "results"
    (folder / "data").mkdir(parents=True)
    page = "about <!--= {{ sig(tail.found.k.value) }} -->old<!--/--> N m/rad"
    (folder / "page.md").write_text(page)
    (folder / "data" / "tail.json").write_text('{"found": {"k": {"value": 0.98312}}}')
    return tmp_path


def test_a_page_is_written_from_its_json(small):
    (page,) = result_pages.write(small)
    assert page.read_text().endswith("-->0.983<!--/--> N m/rad")
    assert result_pages.write(small) == []


@pytest.mark.parametrize(
    ("held", "said"),
    [
        ('{"found": {"k": {}}}', "docs/results/data/tail.json: field found.k.value is missing"),
        ('{"found": 3}', "docs/results/data/tail.json: 'int object' has no attribute 'k'"),
        ('{"found": {"k"', "docs/results/data/tail.json: not JSON"),
    ],
)
def test_json_that_lacks_a_field_is_refused_and_nothing_written(small, held, said):
    (small / "docs" / "results" / "data" / "tail.json").write_text(held)
    with pytest.raises(BadInput) as told:
        result_pages.write(small)
    assert said in str(told.value) and "\n" not in str(told.value)
    assert "-->old<!--/-->" in (small / "docs" / "results" / "page.md").read_text()


def test_a_result_that_is_not_there_says_how_to_make_it(small):
    (small / "docs" / "results" / "data" / "tail.json").unlink()
    (page,) = result_pages.write(small)
    assert "*Not measured yet: `make results ARGS=tail`.*" in page.read_text()


def test_a_success_rate_has_its_count_and_interval():
    row = {"targets": 2000, "arrived": 0.998, "arrived_interval": (0.9928, 0.9995)}
    assert result_cells.rate(row) == "1,996 of 2,000 (99.3–100.0 %)"


@pytest.mark.parametrize(
    ("value", "digits", "shown"),
    [(0.0011149, 3, "0.00111"), (12.345, 3, "12.3"), (1234.5, 2, "1200"), (None, 3, "–")],
)
def test_significant_digits_are_shown_without_an_exponent(value, digits, shown):
    assert result_cells.sig(value, digits) == shown


def test_cells_show_signs_intervals_and_missing_numbers():
    assert result_cells.fix(-0.04, 1) == "0.0" and result_cells.fix(-1234.5) == "-1,234"
    assert result_cells.span((0.0141, 0.01432), 3, 1000) == "14.1 … 14.3"
    assert result_cells.per_cent(0.0312) == "3.1 %" and result_cells.per_cent(None) == "–"
    assert result_cells.off(0.98, 1.0) == result_cells.off(1.02, 1.0) == "2.0 %"
    assert result_cells.error(0.0081, "m/s") == "8.1 mm/s"
    never = {"size": None, "interval": (76.24, None), "most": 300}
    assert result_cells.margin(never) == "over 300 (76.2 – over 300)"
    rows = [{"s": 0.3}, {"s": 0.1}]
    assert (result_cells.smallest(rows, "s"), result_cells.largest(rows, "s")) == (0.1, 0.3)
    assert result_cells.largest([*rows, {"s": None}], "s") is None  # never is worse than late


def test_rows_are_picked_by_their_fields():
    rows = [{"a": 1, "b": 2, "targets": 60, "arrived": 0.95}, {"a": 1, "b": 3}]
    assert result_cells.unique(rows, "a") == [1] and result_cells.unique(rows, "b") == [2, 3]
    assert result_cells.pick(rows, a=1, b=3) is rows[1]
    assert result_cells.hits(rows[0]) == 57
    with pytest.raises(BadInput, match="no row with"):
        result_cells.pick(rows, a=2)


def test_a_result_says_how_it_was_made():
    entry = results.Entry(about="", steps=("tailbeat show pulley-fish",), minutes=1)
    text = result_cells.made({"origin": results.origin("nothing", entry) | {"seconds": [90, 30]}})
    assert "```\ntailbeat show pulley-fish\n```" in text and "2.0 minutes" in text
    assert "mujoco" in text and "commit" in text


# ---- fish and policies that a result was measured with -------------------------------------------


def test_no_two_fish_or_policies_share_a_file_s_name():
    """A result is told by these names: the earlier twin, named as today's, hid that one."""
    folders = [result_files.ROOT / folder for folder in result_files.FOLDERS]
    files = [path for one in folders for path in one.glob("*.*")]
    known = [path for path in files if path.suffix in (".toml", ".onnx")]
    assert len(result_files.shipped()) == len(known)


def test_steps_name_fish_and_policies_by_name_path_wildcard_and_loop():
    def named(*steps):
        return result_files.named(steps)

    assert named("tailbeat show pulley-fish-pool --out $OUT/a") == ["pulley-fish-pool"]
    assert named("sed s/a/b/ src/tailbeat/fish/models/crank-fish.toml > b") == ["crank-fish"]
    assert len(named("tailbeat compare examples/policies/*.onnx")) == 8
    loop = "for a in generator-1 signal; do tailbeat x examples/policies/pulley-fish-pool-$a.onnx"
    assert named(loop) == ["pulley-fish-pool-generator-1", "pulley-fish-pool-signal"]
    assert ENTRIES["swims"].after == ("recordings",)
    assert results.files(ENTRIES["swims"]) == {"pulley-fish", "pulley-fish-pool"}


OLD = {"crank-fish": "00000000"}
FISH = """# comment
name = "a"
force_limit = {value = 1.0, unit = "N m", source = "paper"}
"""


@pytest.fixture
def repository(tmp_path):
    """Makes a repository with one fish of the given text."""

    def make(text: str, name: str = "pool") -> Path:
        folder = tmp_path / str(len(list(tmp_path.iterdir()))) / result_files.FOLDERS[0]
        folder.mkdir(parents=True)
        (folder / f"{name}.toml").write_text(text)
        return folder.parents[3]

    return make


def test_a_result_is_of_today_until_a_number_of_its_fish_changes(repository):
    root = repository(FISH)
    origin = {"steps": ["tailbeat show pool"], "files": result_files.digests(["pool"], root)}
    assert result_files.changed(origin, root) == []
    words = FISH.replace("comment", "other").replace("paper", "measured")
    assert result_files.changed(origin, repository(words)) == []
    assert result_files.changed(origin, repository(FISH.replace("1.0", "1.1"))) == ["pool"]
    assert result_files.changed(origin, repository(FISH, "other")) == ["pool"]  # no longer shipped
    assert result_files.changed(origin | {"files": {}}, root) == ["pool"]  # new since


def test_a_policy_is_known_by_its_contract():
    names = [name for name, path in result_files.shipped().items() if path.suffix == ".onnx"]
    assert len(set(result_files.digests(names).values())) == len(names) > 8


def test_a_page_says_what_changed_since_its_result():
    origin = results.origin("nothing", results.Entry(about="", steps=(), minutes=1))
    new, old = ({"origin": origin | {"seconds": [60], "files": files}} for files in ({}, OLD))
    assert "Measured before today's version of:** `crank-fish`." in result_cells.made(old)
    assert "before" not in result_cells.made(new)
    said = "Measured with an earlier fish or policy: `old`."
    assert result_cells.stale(new=new, old=old) == said and result_cells.stale(new=new) == ""


# ---- running the steps ---------------------------------------------------------------------------

STEPS = (
    'echo x >> $OUT/first; echo "{\\"a\\": 0.123456789}" > $OUT/json/part.json',
    "test -f $OUT/allowed",
)


@pytest.fixture
def bare(tmp_path, monkeypatch) -> Path:
    """A repository without results; returns the folder in which result `one` works."""
    monkeypatch.setattr(results, "ROOT", tmp_path)
    (tmp_path / "docs" / "results").mkdir(parents=True)
    return tmp_path / results.RESULTS / "one"


def test_an_interrupted_result_goes_on_with_its_next_step(bare):
    entry = results.Entry(about="", steps=STEPS, minutes=1)
    with pytest.raises(BadInput, match="one: exit code 1 from: test -f"):
        results.make("one", entry, again=False)
    assert not result_pages.data_path(results.ROOT, "one").exists()
    (bare / "allowed").touch()
    results.make("one", entry, again=False)
    held = json.loads(result_pages.data_path(results.ROOT, "one").read_text())
    assert held["part"] == {"a": 0.123457} and len(held["origin"]["seconds"]) == 2
    assert (bare / "first").read_text() == "x\n"


def test_a_result_of_an_earlier_fish_is_made_again_from_its_first_step(bare):
    entry = results.Entry(about="", steps=STEPS[:1], minutes=1, uses=("crank-fish",))
    results.make("one", entry, again=False)
    path = result_pages.data_path(results.ROOT, "one")
    assert not results.missing("one") and results.done({"one": entry}, "one")
    for held in (path, bare / "files.json"):
        held.write_text(held.read_text().replace(str(result_files.digests(OLD)["crank-fish"]), "0"))
    assert results.missing("one") and not results.done({"one": entry}, "one")
    results.make("one", entry, again=False)
    assert not results.missing("one") and (bare / "first").read_text() == "x\n"


def test_pictures_are_copied_and_a_missing_one_is_said(bare):
    steps = ('echo drawn > $OUT/a.png; echo "{}" > $OUT/json/part.json',)
    entry = results.Entry(about="", steps=steps, minutes=1, pictures={"shown": "a.png"})
    results.make("one", entry, again=False)
    shown = results.ROOT / "docs" / "results" / "pictures" / "shown.png"
    assert shown.read_text() == "drawn\n"
    wrong = entry.model_copy(update={"pictures": {"shown": "b.png"}})
    with pytest.raises(BadInput, match=r"b\.png: no step of one drew it"):
        results.make("one", wrong, again=False)


def test_steps_call_this_package(bare):
    step = "tailbeat show nothing-such --json $OUT/json/fish.json"
    with pytest.raises(BadInput, match="exit code 2 from: tailbeat show"):
        results.make("one", results.Entry(about="", steps=(step,), minutes=1), again=False)


def test_fields_are_dropped_in_every_row():
    parts = {"a": {"rows": [{"b": 1, "c": 2}, {"b": 3}], "b": 4}}
    results._drop(parts, ["a", "rows", "*", "b"])
    assert parts == {"a": {"rows": [{"c": 2}, {}], "b": 4}}


def test_what_is_there_is_kept_and_what_a_result_reads_comes_first(bare):
    entries = {
        "base": results.Entry(about="", steps=("true",), minutes=1),
        "one": results.Entry(about="", steps=("true",), minutes=1, after=("base",)),
    }
    assert results.chosen(entries, ["one"], again=False) == ["base", "one"]
    for name in entries:
        path = result_pages.data_path(results.ROOT, name)
        path.parent.mkdir(exist_ok=True)
        path.write_text('{"origin": {"steps": [], "files": {}}}')
    assert results.chosen(entries, [], again=False) == []
    assert results.chosen(entries, ["one"], again=True) == ["base", "one"]
    with pytest.raises(BadInput, match="two: no such result; allowed are base, one"):
        results.chosen(entries, ["two"], again=False)


def test_times_are_not_measured_on_a_busy_machine(bare, monkeypatch):
    monkeypatch.setattr(results.os, "getloadavg", lambda: (2.5, 1.0, 1.0))
    entry = results.Entry(about="", steps=("true",), minutes=1, quiet=True)
    with pytest.raises(BadInput, match="wait until it is below"):
        results.check(entry, "one", busy=False)
    results.check(entry, "one", busy=True)


def test_a_wrong_field_of_the_commands_is_named(tmp_path):
    path = tmp_path / "commands.toml"
    shutil.copy(FOLDER / "commands.toml", path)
    path.write_text(path.read_text("utf-8").replace("minutes = 1\n", 'minutes = "soon"\n', 1))
    with pytest.raises(BadInput, match=r"commands.toml: field bench\.minutes|field minutes"):
        results.read_entries(path)
