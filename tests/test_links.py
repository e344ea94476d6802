"""Links of README and documentation lead to files and headings that exist, and every page is in the navigation."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md")] + sorted(
    ROOT.glob("docs/**/*.md")
)
LINK = re.compile(r"\]\((?!https?://|mailto:)([^)#\s]*)(?:#([^)\s]*))?\)")
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
HEADING = re.compile(r"^#+ (.*?)(?: *\{ *#([\w-]+) *\})? *$", re.MULTILINE)
README_LINES = 150


def anchors(page: Path) -> set[str]:
    """Names of a page's headings, as the site gives them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return {own or slug(title) for title, own in HEADING.findall(text)}


def slug(title: str) -> str:
    """Name of a heading without one of its own."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())


def dead_links(page: Path) -> list[str]:
    """Links of a page that lead nowhere."""
    dead = []
    for target, anchor in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))):
        file = (page.parent / target).resolve() if target else page
        if not file.exists() or (anchor and file.suffix == ".md" and anchor not in anchors(file)):
            dead.append(f"{target}#{anchor}" if anchor else target)
    return dead


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    assert not dead_links(page)


def test_dead_links_are_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# One two\n[a](page.md#one-two) [b](gone.md) [c](#three) `[d](code.md)` [e](https://x.org/y)\n"
    )
    assert dead_links(page) == ["gone.md", "#three"]


def test_every_page_is_in_the_navigation() -> None:
    """By name, or by its folder."""
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"[\w/]+\.md", settings)) | set(re.findall(r"(\w+/)$", settings, re.MULTILINE))
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in ROOT.glob("docs/**/*.md")}
    assert not {page for page in pages if page not in named and page.rpartition("/")[0] + "/" not in named}


COMMAND = re.compile(r"^(?: {4}| {6}- run: )(python3 -m venv \.venv .*)$", re.MULTILINE)
"""README's two commands, which `.ci/run` takes out of it likewise."""


@pytest.mark.parametrize("name", ["docs/start.md", "CONTRIBUTING.md", ".github/workflows/ci.yml"])
def test_the_two_commands_are_readmes(name: str) -> None:
    main, tests = COMMAND.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    assert main.endswith(".venv/bin/hyjax relight") and tests.endswith(".venv/bin/pytest")
    assert COMMAND.findall((ROOT / name).read_text(encoding="utf-8")) == [main, tests]


def test_the_sites_index_begins_as_readme_does() -> None:
    """Its links, too, which the build leads from README's folder to that of the pages."""
    (marker,) = re.findall(r'^BEGINNING = "(.*)"$', (ROOT / "docs" / "hooks.py").read_text(encoding="utf-8"), re.M)
    assert (ROOT / "docs" / "index.md").read_text(encoding="utf-8").startswith(marker)
    beginning = (ROOT / "README.md").read_text(encoding="utf-8").partition("\n## ")[0]
    assert LINK.findall(beginning) and all(target.startswith("docs/") for target, _ in LINK.findall(beginning))


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= README_LINES
