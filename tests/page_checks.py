"""Checks of a report's page: well formed, nothing loaded from outside."""

import html.parser

VOID = {"img", "meta"}
RUDE = "<b>&amp;\"'$x_$</script>"
"""A name that must be escaped everywhere."""


class Strict(html.parser.HTMLParser):
    """Fails on tags that do not match, repeated ids, and anything loaded from outside."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.targets: list[str] = []
        self.used: set[str] = set()
        self.drawings: set[str] = set()
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.used.add(tag)
        names = [name for name, _ in attrs]
        assert len(names) == len(set(names)), f"<{tag}> says {names}"
        for name, value in attrs:
            assert not name.startswith("on"), f"<{tag} {name}>"
            if name in ("src", "href", "srcset", "action", "data"):
                assert (value or "").startswith(("data:image/", "#")), f"<{tag} {name}={value}>"
                self.targets += [value[1:]] if value and value.startswith("#") else []
            elif name == "id":
                self.ids.append(value or "")
                if tag == "g" and (value or "").endswith("-figure_1"):
                    self.drawings.add((value or "").removesuffix("-figure_1"))
            else:
                assert "//" not in (value or ""), f"<{tag} {name}={value}>"

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, f"</{tag}> closes another"

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def parse(text: str) -> Strict:
    """The page, parsed."""
    parser = Strict()
    parser.feed(text)
    parser.close()
    assert not parser.open
    assert len(parser.ids) == len(set(parser.ids))
    assert set(parser.targets) <= set(parser.ids)
    return parser
