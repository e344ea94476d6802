"""Pictures and templates of a report: small enough for one file, everything escaped."""

import base64
import itertools
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup
from page_checks import RUDE

from hyjax.tuning.report_page import Example, contact_sheet_rows, data_uris, pair_to_compare
from hyjax.util.contact_sheet import contact_sheet, write_contact_sheet
from hyjax.util.errors import InputError
from hyjax.util.images import read_image
from hyjax.util.templates import templates


def examples(count: int = 2, height: int = 24, width: int = 32, seed: int = 0) -> list[Example]:
    rng = np.random.default_rng(seed)
    headings = ["frame", "paper-50 filter", "tuned filter", "paper-50", "tuned", f"target {RUDE}"]
    return [
        (
            f"frame {i} {RUDE}",
            {heading: rng.uniform(-0.1, 1.1, (height, width, 3)).astype(np.float32) for heading in headings},
        )
        for i in range(count)
    ]


def test_templates_escape_all_but_markup(tmp_path: Path) -> None:
    (tmp_path / "t.jinja").write_text('<a title="{{ text }}">{{ text }}{{ mark }}</a>')
    escaped = "&lt;b&gt;&amp;amp;&#34;&#39;$x_$&lt;/script&gt;"
    shown = templates(tmp_path).get_template("t.jinja").render(text=RUDE, mark=Markup("<i></i>"))
    assert shown == f'<a title="{escaped}">{escaped}<i></i></a>'


def test_pictures_are_lossless_where_they_fit(tmp_path: Path) -> None:
    (example,) = examples(1)
    (uris,) = data_uris([example])
    _, pictures = example
    assert list(uris) == list(pictures)
    for heading, uri in uris.items():
        np.testing.assert_allclose(decode(uri, tmp_path), np.clip(pictures[heading], 0, 1), atol=0.51 / 255)


def test_pictures_shrink_until_they_fit(tmp_path: Path) -> None:
    given = examples(2, 300, 400)
    found = data_uris(given, most_bytes=400_000)
    sizes = {decode(uri, tmp_path).shape for uris in found for uri in uris.values()}
    assert len(sizes) == 1 and (300, 400, 3) not in sizes
    assert all(uri.startswith("data:image/jpeg") for uris in found for uri in uris.values())
    assert sum(len(uri) for uris in found for uri in uris.values()) < 4 / 3 * 400_000 + 12 * 40
    with pytest.raises(InputError, match="2 examples are too many"):
        data_uris(given, most_bytes=1000)


def decode(uri: str, folder: Path) -> np.ndarray:
    head, content = uri.split(",")
    path = folder / f"x.{'png' if 'png' in head else 'jpg'}"
    path.write_bytes(base64.b64decode(content))
    return read_image(path)


@pytest.mark.parametrize(
    ("headings", "pair"),
    [
        (["frame", "paper-50 filter", "tuned filter", "paper-50", "tuned", "target"], (3, 4)),
        (["a", "b", "c"], (1, 2)),
        (["a"], (0, 0)),
    ],
)
def test_pair_to_compare(headings: list[str], pair: tuple[int, int]) -> None:
    assert pair_to_compare(headings) == pair


def test_contact_sheet(tmp_path: Path) -> None:
    one, two = examples(2)
    two = two[0], dict(itertools.islice(two[1].items(), 2))
    rows, headings = contact_sheet_rows([one, two])
    assert headings == list(one[1]) and [len(pictures) for _, pictures in rows] == [6, 6]
    assert [label for label, _ in rows] == [one[0], two[0]]
    write_contact_sheet(tmp_path / "contact_sheet.png", rows, headings)
    np.testing.assert_allclose(
        read_image(tmp_path / "contact_sheet.png"), contact_sheet(rows, headings), atol=0.6 / 255
    )
