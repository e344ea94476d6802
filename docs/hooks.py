"""Build hooks of the documentation site: equations as MathML, figures from the experiments, pages of a folder,
README's beginning, the version, an exported page to try, and which pages a search shows first.

Equations stay TeX in the pages and need no JavaScript in the browser. Figures lie beside the experiments that make
them; a page links them as `../experiments/figures/NAME`, which also works where the page is read as a file.
"""

import html
import re
from pathlib import Path
from typing import Any

import latex2mathml.converter
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "experiments" / "figures"
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
BEGINNING = "<!-- README.md, up to its first heading -->"
"""Where README's title and introduction go, which are written there alone."""
EXPORTED = "<!-- the exported page, where it was made -->"
"""Where the page goes that `hyjax export --to web` has left in the folder `demo` of the settings."""
FRAME = '<template id="exported"><iframe title="The room, relit" src="demo/index.html"></iframe></template>'
MOST_BYTES = 10_000_000
"""Of the exported page in all."""
VERSION = re.compile(r'^__version__ = "(.*)"', re.MULTILINE)
BOOSTS = {
    "start.md": 4,
    "your_own_room.md": 4,
    "method.md": 4,
    "own_data.md": 4,
    "gallery.md": 0.1,
    "results/": 0.01,
    "reference/": 0.001,
}
"""Factors of a search's scores, of a page or a folder: a word in a title counts a thousand times."""
FIGURE_LINK = re.compile(r"\]\((\.\./)+experiments/figures/")


def on_config(config: Any) -> Any:
    """Put the pages of a folder into the navigation where it names the folder, and leave out what is not there."""
    docs = Path(config["docs_dir"])
    config["nav"] = [entry for entry in (_expanded(entry, docs) for entry in config["nav"]) if entry]
    config["copyright"] = f"hyjax {VERSION.search((ROOT / 'hyjax' / '__init__.py').read_text(encoding='utf-8'))[1]}"
    if repository := (config["repo_url"] or "").rstrip("/"):
        links = {"repository": repository, "issues": f"{repository}/issues"}
        config["copyright"] += "".join(f' · <a href="{address}">{name}</a>' for name, address in links.items())
    return config


def _expanded(entry: Any, docs: Path) -> Any:
    if isinstance(entry, str):
        return entry if (docs / entry).is_file() else None
    ((title, target),) = entry.items()
    if isinstance(target, str) and target.endswith("/"):
        listed = re.findall(r"\]\(([\w-]+\.md)", (docs / target / "index.md").read_text(encoding="utf-8"))
        order = {name: number for number, name in enumerate(["index.md", *listed])}
        pages = sorted((docs / target).glob("*.md"), key=lambda page: (order.get(page.name, len(order)), page.name))
        return {title: [page.relative_to(docs).as_posix() for page in pages]} if pages else None
    if isinstance(target, str):
        return entry if (docs / target).is_file() else None
    return {title: [inner for inner in (_expanded(each, docs) for each in target) if inner]}


def on_files(files: Files, config: Any) -> Files:
    """Add the experiments' figures and the exported page to the site.

    Raises:
        PluginError: the exported page is larger than a site takes.
    """
    demo = ROOT / config["extra"]["demo"]
    exported = [path for path in sorted(demo.rglob("*.*")) if path.suffix != ".md"]
    if (size := sum(path.stat().st_size for path in exported)) > MOST_BYTES:
        raise PluginError(f"{demo}: {size / 1e6:.1f} MB; a site takes {MOST_BYTES / 1e6:g}: export fewer frames")
    added = {f"figures/{path.name}": path for path in sorted(FIGURES.glob("*.*"))}
    added |= {f"demo/{path.relative_to(demo).as_posix()}": path for path in exported}
    for name, path in added.items():
        files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, **_: Any) -> str:
    """Put in README's beginning and the exported page; links to the figures' files become links to the site's."""
    folder, slash, _ = page.file.src_uri.partition("/")
    page.meta["search"] = {"boost": BOOSTS.get(folder + slash, 1)}
    beginning = (ROOT / "README.md").read_text(encoding="utf-8").partition("\n## ")[0]
    markdown = markdown.replace(BEGINNING, beginning.replace("](docs/", "]("))
    exported = (ROOT / config["extra"]["demo"] / "index.html").is_file()
    markdown = markdown.replace(EXPORTED, FRAME * exported)
    up = "../" * page.file.src_uri.count("/")
    return FIGURE_LINK.sub(f"]({up}figures/", markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Turn equations into MathML."""
    return EQUATION.sub(_mathml, content)


def _mathml(found: re.Match[str]) -> str:
    display = "inline" if found[1] == "span" else "block"
    mathml = latex2mathml.converter.convert(html.unescape(found[3]).strip(), display=display)
    return mathml if display == "inline" else f'<div class="equation">{mathml}</div>'
