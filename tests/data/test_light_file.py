"""Lights files: every kind, both syntaxes, round trips, and every mistake answered with one helpful line."""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
import yaml

from hyjax.data.light_file import is_light_file, parse_lights, read_lights, write_lights
from hyjax.light.color import blackbody
from hyjax.light.kinds import LIGHT_KINDS, DirectionalLight, PointLight, RectLight, SkyLight
from hyjax.light.setup import REFERENCE_LUX, LightSetup
from hyjax.util.errors import InputError

UP = np.array([0.0, 0.0, 1.0])
RECT = {"center": [0, 1, 2], "normal": [0, 2, 0], "width": 1.6, "height": 1.2}
FLUX = {"luminous_flux": 800}
ENTRIES: dict[str, dict[str, Any]] = {
    "point": {
        "position": [1, 2, 3],
        "luminous_flux": 800,
        "radius": 0.05,
        "temperature": 2700,
        "name": "floor lamp",
    },
    "spot": {
        "position": [0, 0, 2],
        "target": [1, 0, 0],
        "luminous_flux": 500,
        "inner_degrees": 20,
        "outer_degrees": 35,
    },
    "directional": {"direction": [1, 1, -1], "illuminance": 900, "angular_degrees": 0.5, "aperture": RECT},
    "rect": {**RECT, "luminous_flux": 3000, "color": [0.5, 0.75, 1.5]},
    "sky": {"illuminance": 100, "up": [0, 1, 0]},
    "ambient": {"illuminance": 10},
}
ALL = {"reference_lux": 123.5, "lights": [{"kind": kind} | entry for kind, entry in ENTRIES.items()]}


def one(kind: str, **changes: Any) -> dict[str, Any]:
    """A file with one light; a change to None removes the key."""
    entry = {"kind": kind} | ENTRIES[kind] | changes
    return {"lights": [{key: value for key, value in entry.items() if value is not None}]}


def same(a: LightSetup, b: LightSetup) -> None:
    assert a.reference_lux == b.reference_lux
    assert jax.tree.structure(a.lights) == jax.tree.structure(b.lights)
    for x, y in zip(jax.tree.leaves(a.lights), jax.tree.leaves(b.lights)):
        np.testing.assert_allclose(x, y, rtol=1e-6, atol=1e-6)


def refuses(content: Any, *parts: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_lights(content, UP, "file.yaml")
    message = str(caught.value)
    assert "\n" not in message and message.startswith("file.yaml")
    for part in parts:
        assert part in message


def test_every_kind_is_covered() -> None:
    assert set(ENTRIES) == set(LIGHT_KINDS)


def test_yaml_and_json_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("# comment\n" + yaml.safe_dump(ALL))
    (tmp_path / "a.json").write_text(json.dumps(ALL))
    same(read_lights(tmp_path / "a.yaml", UP), read_lights(tmp_path / "a.json", UP))
    same(read_lights(tmp_path / "a.yaml", UP), parse_lights(ALL, UP))


def test_lights_files_are_known_by_their_ending() -> None:
    assert all(is_light_file(text) for text in ("a.yaml", "folder/a.yml", "A.JSON"))
    assert not any(is_light_file(text) for text in ("evening-lamps", "a.json.txt", "json"))


def test_written_set_ups_read_back(tmp_path: Path) -> None:
    setup = parse_lights(ALL, UP)
    write_lights(tmp_path / "lights.json", setup)
    same(read_lights(tmp_path / "lights.json", np.array([1.0, 0.0, 0.0])), setup)  # nothing depends on `up` now
    assert [entry.name for entry in tmp_path.iterdir()] == ["lights.json"]


def test_units_and_defaults() -> None:
    point, spot, sun, rect, sky, ambient = parse_lights(ALL, UP).lights
    np.testing.assert_allclose(point.color, blackbody(2700), rtol=1e-6)
    assert float(point.luminous_flux) == 800 and float(point.radius) == pytest.approx(0.05)
    np.testing.assert_allclose(spot.direction, np.array([1, 0, -2]) / np.sqrt(5), rtol=1e-6)
    assert np.rad2deg([spot.inner_angle, spot.outer_angle]) == pytest.approx([20, 35])
    np.testing.assert_allclose(spot.color, 1.0)
    np.testing.assert_allclose(sun.direction, np.array([1, 1, -1]) / np.sqrt(3), rtol=1e-6)
    assert np.rad2deg(sun.angular_radius) == pytest.approx(0.5)
    assert float(rect.luminous_flux) == 3000
    np.testing.assert_allclose(rect.color, [0.5, 0.75, 1.5])
    np.testing.assert_allclose(sky.up, [0, 1, 0])
    assert float(ambient.illuminance) == 10
    assert parse_lights({"lights": [one("point")["lights"][0]]}, UP).reference_lux == REFERENCE_LUX
    (default_sky,) = parse_lights(one("sky", up=None), UP).lights
    assert isinstance(default_sky, SkyLight)
    np.testing.assert_allclose(default_sky.up, UP)


@pytest.mark.parametrize("normal", [[0, 1, 0], [1, 0, 0], [0, -1, 0.3], [0, 0, -1], [0, 0, 1]])
def test_rectangles_emit_along_their_normal(normal: list[float]) -> None:
    """Also straight up and down, where the world's `up` gives no orientation."""
    (light,) = parse_lights(one("rect", normal=normal), UP).lights
    assert isinstance(light, RectLight)
    right, up = np.asarray(light.right, float), np.asarray(light.up, float)
    unit = np.array(normal) / np.linalg.norm(normal)
    np.testing.assert_allclose(np.cross(right, up), 0.8 * 0.6 * unit, atol=1e-6)
    assert np.linalg.norm(right) == pytest.approx(0.8) and np.linalg.norm(up) == pytest.approx(0.6)
    assert up @ UP >= -1e-6


def test_aperture_is_a_rectangle_facing_inwards() -> None:
    (sun,) = parse_lights(one("directional"), UP).lights
    assert isinstance(sun, DirectionalLight) and sun.aperture is not None
    np.testing.assert_allclose(sun.aperture.center, [0, 1, 2])
    np.testing.assert_allclose(np.cross(sun.aperture.right, sun.aperture.up), [0, 0.48, 0], atol=1e-6)
    (bare,) = parse_lights(one("directional", aperture=None), UP).lights
    assert isinstance(bare, DirectionalLight) and bare.aperture is None


def test_zero_power_is_allowed() -> None:
    (light,) = parse_lights(one("point", luminous_flux=0), UP).lights
    assert isinstance(light, PointLight) and float(light.luminous_flux) == 0


@pytest.mark.parametrize(
    "word, right",
    [("poin", "point"), ("Spot", "spot"), ("directionl", "directional"), ("rectangle", "rect"), ("amb", "ambient")],
)
def test_a_misspelt_kind_names_the_nearest(word: str, right: str) -> None:
    refuses({"lights": [{"kind": word}]}, "light 0", repr(word), f"did you mean {right!r}")


@pytest.mark.parametrize(
    "kind, wrong, right",
    [
        ("point", "postion", "position"),
        ("point", "Luminous_flux", "luminous_flux"),
        ("point", "colour", "color"),
        ("spot", "outer_degree", "outer_degrees"),
        ("rect", "centre", "center"),
        ("sky", "iluminance", "illuminance"),
    ],
)
def test_a_misspelt_key_names_the_nearest(kind: str, wrong: str, right: str) -> None:
    refuses(one(kind, **{wrong: 1}), f"light 0 ({kind})", repr(wrong), f"did you mean {right!r}")
    nested = one("directional", aperture={**RECT, "centre": [0, 0, 0]})
    refuses(nested, "aperture", "'centre'", "did you mean 'center'")


def test_misspelt_keys_of_the_file_itself() -> None:
    refuses({"light": [], "lights": []}, "'light'", "did you mean 'lights'")
    refuses(ALL | {"reference": 3}, "did you mean 'reference_lux'")


@pytest.mark.parametrize("key", ["luminous_flux", "radius"])
@pytest.mark.parametrize(
    "value", [-1, float("nan"), float("inf"), "bright", True, [1], None, pytest.param(10**400, id="10**400"), 1e39]
)
def test_numbers_are_checked(key: str, value: Any) -> None:
    entry = {"kind": "point"} | ENTRIES["point"] | {key: value}
    refuses({"lights": [entry]}, "light 0 (point)", repr(key))


@pytest.mark.parametrize(
    "value", [[1, 2], [1, 2, 3, 4], "123", 5, [1, 2, "x"], [1, 2, float("nan")], [True, 0, 0], None]
)
def test_vectors_are_checked(value: Any) -> None:
    entry = {"kind": "point"} | ENTRIES["point"] | {"position": value}
    refuses({"lights": [entry]}, "'position'", "three finite numbers")


BAD = [
    (one("point", position=None), ("'position' is missing",)),
    (one("ambient", illuminance=None), ("'illuminance' is missing",)),
    (one("ambient", illuminance=-3), (">= 0", "-3")),
    (one("rect", width=0), ("'width'", "> 0")),
    (one("rect", height=-1), ("'height'",)),
    (one("rect", normal=[0, 0, 0]), ("'normal'", "zero")),
    (one("rect", up=[0, 1, 0]), ("parallel",)),
    (one("directional", direction=[0, 0, 0]), ("'direction'", "zero")),
    (one("directional", aperture=[1, 2]), ("aperture", "mapping")),
    (one("spot", direction=[0, 0, -1]), ("either 'target'",)),
    (one("spot", target=None), ("either 'target'",)),
    (one("spot", target=[0, 0, 2]), ("zero",)),
    (one("spot", inner_degrees=40), ("inner_degrees < outer_degrees", "40", "35")),
    (one("spot", outer_degrees=95), ("<= 90",)),
    (one("point", color=[1, 1, 1]), ("either 'color' or 'temperature'",)),
    (one("point", temperature=500), ("1667..25000",)),
    (one("rect", color=[1, -0.1, 1]), ("'color'", "negative")),
    (ALL | {"reference_lux": 0}, ("'reference_lux'", "> 0")),
    ({"lights": []}, ("at least one",)),
    ({"lights": {"kind": "point"}}, ("list",)),
    ({"lights": ["point"]}, ("light 0", "mapping")),
    ({}, ("'lights'",)),
    ([], ("mapping",)),
    (None, ("mapping",)),
    ("point", ("mapping",)),
    ({"lights": [{"kind": None}]}, ("kind",)),
    ({"lights": [{"kind": ["point"]}]}, ("kind",)),
    ({1: 2, "lights": []}, ("1",)),
]


@pytest.mark.parametrize("content, parts", BAD, ids=[parts[0] for _, parts in BAD])
def test_bad_content_is_one_line(content: Any, parts: tuple[str, ...]) -> None:
    refuses(content, *parts)


def test_the_bad_light_is_named_by_its_number() -> None:
    refuses(
        {"lights": [*ALL["lights"], {"kind": "point", "position": [0, 0, 0], "luminous_flux": -1}]},
        "light 6 (point)",
    )


@pytest.mark.parametrize(
    "content",
    [
        b"lights: [\n",
        b"\xff\xfe\x00\x80",
        b"a: b: c",
        b"lights: *missing",
        b"!!python/object:os.x {}",
        b'{"lights": [}',
        b"\x00",
    ],
)
def test_files_that_are_neither_yaml_nor_json(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "lights.yaml"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_lights(path, UP)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    assert "neither YAML nor JSON" in str(caught.value) or "not a text file" in str(caught.value)


def test_missing_and_empty_files(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(InputError, match=r"no such file|is a folder"):
            read_lights(path, UP)
    (tmp_path / "empty.yaml").write_text("")
    with pytest.raises(InputError, match="must be a mapping"):
        read_lights(tmp_path / "empty.yaml", UP)


def test_a_file_of_what_lit_the_photos_is_told_its_option() -> None:
    refuses({"windows": []}, "--photo-sources")
    refuses(one("ambient", windows=[]), "unknown key 'windows'")


def test_messages_stay_on_one_line_whatever_the_value() -> None:
    refuses(one("point", luminous_flux="a\nb"), "'luminous_flux'")
    refuses({"lights": [{"kind": "po\nint"}]}, "kind")
    refuses(one("ambient", **{"x\ny": 1}), "unknown key")


def test_the_old_name_of_the_flux_is_still_read_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    lamp = {"kind": "point", "position": [1, 2, 3]}
    setup = parse_lights({"lights": [lamp | {"power": 800}, lamp | {"power": 900}, lamp | FLUX]}, UP, "old.yaml")
    assert [float(light.luminous_flux) for light in setup.lights] == [800, 900, 800]
    assert [record.getMessage() for record in caplog.records] == [
        "old.yaml: key 'power' is now called 'luminous_flux'; the old name will go"
    ]
    refuses(
        {"lights": [lamp | FLUX | {"power": 800}]}, "light 0 (point)", "'power' is the old name of 'luminous_flux'"
    )
    refuses({"lights": [lamp | {"power": -1}]}, "light 0 (point)", "'luminous_flux'", "-1")
