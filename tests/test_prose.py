"""Pages have short lines, short sentences and our words; and the check can fail."""

import pytest

import prose

PAGES = {page.relative_to(prose.ROOT).as_posix(): page for page in prose.pages()}
LONG = " ".join(["word"] * 26)


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_plain(name):
    found = prose.faults(PAGES[name])
    assert not found, "\n".join(found)


def test_long_lines_are_found_and_links_tables_and_code_are_not():
    assert [line for line, _ in prose.long_lines(f"short\n{'x' * 101}\n")] == [2]
    fine = [
        f"| {'x' * 120} |",
        f"<!--=\n{'x' * 120} -->1.0<!--/-->",
        f"[text](https://{'x' * 120})",
        f"```\n{'x' * 120}\n```",
    ]
    assert not list(prose.long_lines("\n".join(fine)))


@pytest.mark.parametrize(
    "text",
    [f"{LONG}.", f"Short.\n{LONG[:60]}\n{LONG[60:]}", f"- Short.\n- {LONG}", f"# Title\n{LONG}"],
)
def test_a_long_sentence_is_found(text):
    assert len(list(prose.long_sentences(text))) == 1


@pytest.mark.parametrize(
    "text",
    [
        f"{LONG[:70]}. A second {LONG[:70]}",
        f"- {LONG[:90]}\n- {LONG[:90]}",
        f"`{LONG}` is code",
        f"| {LONG} |",
        f"```\n{LONG}\n```",
    ],
)
def test_short_sentences_items_code_and_tables_are_fine(text):
    assert not list(prose.long_sentences(text))


@pytest.mark.parametrize("path", prose.helps(), ids=lambda path: path.stem)
def test_help_texts_have_our_words(path):
    assert prose.help_faults(path) == []


def test_a_wrong_word_in_a_help_text_is_found(monkeypatch, tmp_path):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    path = tmp_path / "a.py"
    path.write_text('''desk = "desk"\nhelp = f"""Start\nthe desk {desk}."""''')
    assert prose.help_faults(path) == ["a.py:2: 'desk': write operator page, or computer"]


def test_a_word_that_has_a_better_one_is_found():
    assert [line for line, _ in prose.wrong_words("fine\nThe warden stops it.")] == [2]
    assert not list(prose.wrong_words("`warden` in code, and awardens"))
