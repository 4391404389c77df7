"""What README and tutorials tell the reader to do works: every block, in an empty folder, from top to bottom."""

import re
from pathlib import Path

import pytest
from kept import kept
from places import CHECKOUT
from walk import FENCE, Stopped, blocks, faults, walk, walked

DOCS = CHECKOUT / "docs"
PAGES = [CHECKOUT / "README.md", *sorted(DOCS.glob("start/*.md")), *sorted(DOCS.glob("tutorials/*.md"))]
NAMES = [str(page.relative_to(CHECKOUT)) for page in PAGES]
LONGEST_SENTENCE = 30


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_every_block_of_a_page_runs_in_an_empty_folder(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert (kept(walked, text) / "printed.json").exists()


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_the_blocks_of_a_page_say_what_they_are(page: Path) -> None:
    assert faults(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_the_links_of_a_page_lead_to_pages_and_files_that_are_there(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    local = [t for t in re.findall(r"(?<!!)\]\(([^)\s#]+)[^)]*\)", text) if "://" not in t]
    assert [t for t in local if not (page.parent / t).exists() and not _made_by_the_page(t)] == []


@pytest.mark.parametrize("page", [p for p in PAGES if p.parent != CHECKOUT], ids=[n for n in NAMES if "/" in n])
def test_sentences_of_a_tutorial_are_short(page: Path) -> None:
    long = [s for s in sentences(page.read_text(encoding="utf-8")) if len(s.split()) > LONGEST_SENTENCE]
    assert long == []


def _made_by_the_page(target: str) -> bool:
    """Whether the blocks of the page make it: the build of the documentation asks for it."""
    return target.endswith((".html", ".png")) and not target.startswith("..")


def sentences(page: str) -> list[str]:
    """Return the sentences of a page, without blocks and tables; a formula, a link and a piece of code are a word."""
    text = re.sub(r"<!--.*?-->", "", FENCE.sub("", page), flags=re.S)
    text = re.sub(r"^---\n.*?^---\n", "", text, flags=re.S | re.M)
    text = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith(("|", "#", ":::", "![")))
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"\$[^$]+\$|`[^`]+`", "X", text))
    pieces = re.split(r"\n\s*\n", re.sub(r"^\s*(?:[-*]|\d+\.)\s", "\n", text, flags=re.M))
    return [s.strip() for piece in pieces for s in re.split(r"(?<=[.!?:;])\s+", piece) if s.strip()]


def test_a_sentence_ends_where_a_reader_breathes() -> None:
    page = "# Head\n\nOne `two three`\nfour. Five\n\n- six\n- [seven eight](there.md): nine\n\n"
    page += "```sh\nls -l\n```\n| a | b |\n"
    assert sentences(page) == ["One X\nfour.", "Five", "six", "seven eight:", "nine"]


PAGE = """# Page

Write this into `a/campaign.toml`:

```toml
one = 1
```

Add this to `a/campaign.toml`:

```toml
two = 2
```

```sh
cat a/campaign.toml
```

<!-- exit status 3: grep finds nothing -->
```sh
exit 3
```

<!-- not run: it takes a network -->
```sh
false
```

```text
looked at
```
"""


def test_a_page_is_walked_from_top_to_bottom(tmp_path: Path) -> None:
    assert faults(PAGE) == []
    printed = [said for _, said in walk(tmp_path, PAGE)]
    assert printed == ["", "", "one = 1\n\ntwo = 2", "", "", ""]
    assert [b.not_run for b in blocks(PAGE)].count("it takes a network") == 1


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("```sh\nfalse\n```\n", "exit status 1, expected 0"),
        ("<!-- exit status 3: so -->\n```sh\ntrue\n```\n", "exit status 0, expected 3"),
        ("```sh\nsleep | false | cat\n```\n", "exit status 1"),
        ('```python\nraise SystemExit("no")\n```\n', "exit status 1"),
        ('```python\nimport warnings\nwarnings.warn("old")\n```\n', "warnings of Python"),
    ],
)
def test_a_block_that_fails_stops_the_walk_with_its_line(page: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(Stopped, match=said):
        walk(tmp_path, "# Page\n\n" + page)


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ("```\nls\n```\n", "says its language"),
        ("Some words:\n\n```toml\na = 1\n```\n", "must name the file"),
        ("Into `a.toml`:\n\n```toml\na = \n```\n", "no TOML"),
        ("```python\nif\n```\n", "no Python"),
        ("<!-- not run: so -->\n```sh\nls\n```\n", "why"),
    ],
)
def test_a_block_that_nobody_could_run_is_refused_before(page: str, said: str) -> None:
    assert [said in fault for fault in faults(page)] == [True]
