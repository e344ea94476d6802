"""The widget without a browser: traits, messages of its page, pictures."""

import base64
import io
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from extras import need
from PIL import Image
from reference.arkit_export import export_arkit_scan

need("notebooks")

import hyjax
from hyjax.core.refine import _cascade_known
from hyjax.data.builtin_room import UP, load_room
from hyjax.data.capture import Capture, Frame
from hyjax.data.truth_room import TruthCapture
from hyjax.exploration.controls import with_choice, with_level
from hyjax.exploration.pictures import Pictures
from hyjax.exploration.truth import KnownTruth
from hyjax.exploration.widget import DRAFT_MS, Explorer
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.setup import same_setup
from hyjax.util.clock import StageClock
from hyjax.util.images import read_image
from hyjax.util.programs import run_kept


class Boxes(Capture):
    """Three frames of grey pictures in a room with a cube."""

    name, up, fingerprint = "boxes", UP, "boxes"

    def __len__(self) -> int:
        return 3

    def __getitem__(self, index: int) -> Frame:
        pose = look_at(np.array([-1.2 + 0.3 * index, -2.2, 1.5]), np.array([0.5, 0.4, 0.35]), UP)
        image = np.random.default_rng(index).uniform(0.3, 0.7, (48, 64, 3)).astype(np.float32)
        return Frame(f"{index}", image, Camera(Intrinsics(64, 48, 40.0, 40.0, 32.0, 24.0), pose), float(index))


@pytest.fixture(scope="module")
def scene() -> hyjax.Scene:
    walls = trimesh.creation.box(bounds=[[-2, -2.5, 0], [2, 2.5, 2.5]])
    walls.invert()
    cube = trimesh.creation.box((0.7, 0.7, 0.7), trimesh.transformations.translation_matrix([0.5, 0.4, 0.35]))
    return hyjax.Scene(Boxes(), trimesh.util.concatenate([walls, cube]), slack=None)


@pytest.fixture(scope="module")
def own() -> hyjax.Configuration:
    return hyjax.Configuration().with_choices({"photo_light": "kept", "map_scale": 0.1})


@pytest.fixture(scope="module")
def shared(scene: hyjax.Scene, own: hyjax.Configuration) -> Explorer:
    return scene.explore(lights="center-point", configuration=own)


@pytest.fixture
def widget(shared: Explorer, own: hyjax.Configuration) -> Iterator[Explorer]:
    """The widget as it is opened."""
    yield shared
    shared.wait()
    shared.configuration, shared.lights, shared.frame, shared.view, shared.other = (
        own,
        "center-point",
        0,
        "wipe",
        None,
    )
    shared.message = ""
    assert shared.wait(120.0)


def hand(widget: Explorer, kind: str, **content: Any) -> None:
    """Do what the page does when a control is moved."""
    widget._handle_custom_msg({"kind": kind, **content}, [])


def size(jpeg: bytes) -> tuple[int, int]:
    return Image.open(io.BytesIO(jpeg)).size


def test_the_hand_changes_the_configuration(widget: Explorer, own: hyjax.Configuration) -> None:
    before, seen = widget.picture, []
    widget.observe(lambda change: seen.append(change["new"]), "relit")
    hand(widget, "level", cascade="schedule", index=2, key="kappa", value=0.4)
    hand(widget, "choice", name="norm", value="mean_abs")
    assert widget.wait(120.0)
    assert float(widget.configuration.schedule.levels[2].kappa) == np.float32(0.4)
    assert widget.configuration.schedule.norm == "mean_abs" and not widget.message
    assert widget.picture != before and size(widget.picture) == size(widget.photo) == (64, 48)
    assert seen and seen[-1] is widget.relit
    expected = widget._scene.relit(0, "center-point", widget.configuration)
    assert np.array_equal(widget.relit.image, expected.image)
    assert {"cascade", "composite"} <= {stage for stage, _ in widget.times}


def test_python_moves_the_controls(widget: Explorer) -> None:
    widget.configuration, widget.frame, widget.lights = "paper", 1, "two-colors"
    assert widget.configuration == hyjax.Configuration.paper()
    state = widget.state
    assert state["values"]["mode"] == "paper" and state["frame"] == 1 and state["lights"] == "two-colors"
    assert [level["factor"] for level in state["ladders"]["schedule"]] == [16, 8, 4, 2]


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("choice", {"name": "scale", "value": 99}),
        ("choice", {"name": "photo_light", "value": "nonsense"}),
        ("level", {"cascade": "schedule", "index": 0, "key": "lam", "value": 7}),
        ("frame", {"value": 99}),
        ("frame", {"value": "1\n2"}),
        ("lights", {"value": "disco"}),
        ("lights", {"value": [1]}),
        ("view", {"value": "all"}),
        ("preset", {"value": "best"}),
        ("strength", {"index": 77, "value": 3}),
        ("strength", {"index": 0, "value": -3}),
        ("place", {"index": 0, "value": [float("nan"), 0]}),
        ("place", {}),
        ("no such", {}),
    ],
)
def test_what_cannot_be_is_said_on_the_page(widget: Explorer, kind: str, content: dict[str, Any]) -> None:
    before, told = widget.configuration, widget.state["told"]
    hand(widget, kind, **content)
    assert widget.message and "\n" not in widget.message and len(widget.message) < 700
    assert widget.configuration == before and widget.state["told"] == told + 1  # controls are set back


def test_python_is_refused_with_a_line(widget: Explorer) -> None:
    for name, value in (
        ("configuration", "best"),
        ("frame", 3),
        ("frame", None),
        ("lights", "disco"),
        ("view", ""),
    ):
        with pytest.raises(hyjax.InputError):
            setattr(widget, name, value)


def test_lamps_are_moved_and_dimmed(widget: Explorer) -> None:
    place = widget.state["lamps"][0]["place"]
    setup = widget._setup()
    assert setup is not None
    hand(widget, "strength", index=0, value=123.0)
    hand(widget, "place", index=0, value=[place[0] + 0.1, place[1]], draft=True)
    hand(widget, "place", index=0, value=[place[0] + 0.2, place[1]])
    assert widget.wait(120.0)
    lamp, before = widget.lights.lights[0], setup.lights[0]
    assert float(getattr(lamp, lamp.STRENGTH)) == 123.0
    assert np.linalg.norm(np.asarray(lamp.position) - np.asarray(before.position)) > 0.1
    assert widget.state["lamps"][0]["place"] == pytest.approx([place[0] + 0.2, place[1]], abs=1e-4)
    assert widget.state["lights"] == ""


def test_no_change_of_lights_is_lost(widget: Explorer, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, go, relit = threading.Event(), threading.Event(), widget._pictures.relit

    def slow(*arguments: Any) -> hyjax.Relit:
        begun.set()
        go.wait(30.0)
        return relit(*arguments)

    monkeypatch.setattr(widget._pictures, "relit", slow)
    hand(widget, "lights", value="two-colors")
    hand(widget, "strength", index=0, value=5.0)  # of a lamp of the old lights, which are still shown
    assert widget.lights == "two-colors" and "not there yet" in widget.message
    assert begun.wait(30.0)
    own = hyjax.LightSetup.of(hyjax.PointLight(np.array([0.1, -0.4, 2.0]), 700.0, np.ones(3)))
    widget.lights = own  # while the picture of the older ones is made
    hand(widget, "strength", index=0, value=123.0)
    go.set()
    assert widget.wait(120.0)
    hand(widget, "place", index=0, value=[0.5, 0.5])
    assert len(widget.lights.lights) == 1 and float(widget.lights.lights[0].luminous_flux) == 123.0


def test_drafts_are_small_and_followed_by_the_whole(widget: Explorer) -> None:
    sizes: list[tuple[int, int]] = []
    widget.observe(lambda change: sizes.append(size(change["new"])), "picture")
    widget._last_ms = {True: 1e4, False: 1e4}
    hand(widget, "level", cascade="schedule", index=2, key="kappa", value=0.3, draft=True)
    assert widget.wait(120.0)
    assert sizes == [(32, 24), (64, 48)]
    widget.unobserve_all("picture")


def test_drafts_come_back_when_pictures_are_slow_again(widget: Explorer, monkeypatch: pytest.MonkeyPatch) -> None:
    widget._last_ms = {True: 1.0, False: 1.0}
    relit = widget._pictures.relit

    def slow(frame: int, lights: Any, configuration: hyjax.Configuration, clock: StageClock) -> hyjax.Relit:
        with clock("slow"):
            time.sleep(0.1)
        return relit(frame, lights, configuration, clock)

    monkeypatch.setattr(widget._pictures, "relit", slow)
    hand(widget, "level", cascade="schedule", index=2, key="kappa", value=0.31)
    assert widget.wait(120.0) and widget._last_ms[True] > DRAFT_MS
    sizes: list[tuple[int, int]] = []
    widget.observe(lambda change: sizes.append(size(change["new"])), "picture")
    hand(widget, "level", cascade="schedule", index=2, key="kappa", value=0.32, draft=True)
    assert widget.wait(120.0) and sizes == [(32, 24), (64, 48)]
    widget.unobserve_all("picture")


def test_another_sampling_is_another_view(scene: hyjax.Scene) -> None:
    """Pictures of the same kept views are those of the scene, whatever was shown before."""
    lamp = replace(LAMP, position=np.array([0.15, -0.3, 1.9]))
    pictures, lights = Pictures(scene), hyjax.LightSetup.of(lamp)
    for sampling in (2, 1, 2):
        own = hyjax.Configuration().with_choices({"sampling": sampling})
        found = pictures.relit(0, lights, own, StageClock()).image
        np.testing.assert_allclose(found, scene.relit(0, lights, own).image, atol=1e-6)


def test_a_draft_casts_the_shadow_maps_of_divided_light_once(
    scene: hyjax.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    casts: list[float] = []

    def counted(caster: Any, lights: Any, scale: float, *rest: Any, **options: Any) -> Any:
        casts.append(scale)
        return cast_shadow_maps(caster, lights, scale, *rest, **options)

    monkeypatch.setattr("hyjax.scene.scene.cast_shadow_maps", counted)
    lights = hyjax.LightSetup.of(hyjax.PointLight(np.array([0.1, -0.4, 2.0]), 777.0, np.ones(3)))
    Pictures(scene).draft(0, lights, hyjax.Configuration(), StageClock())
    assert casts == [1.0]


def test_a_draft_of_other_lights_follows_no_bounces(scene: hyjax.Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    pictures, clock = Pictures(scene), StageClock()
    first, second = (
        hyjax.LightSetup.of(hyjax.PointLight(np.array([0.1, y, 2.0]), 777.0, np.ones(3))) for y in (-0.4, 0.4)
    )
    whole = pictures.relit(0, first, hyjax.Configuration(), clock).image
    casts: list[float] = []

    def counted(caster: Any, lights: Any, scale: float, *rest: Any, **options: Any) -> Any:
        casts.append(scale)
        return cast_shadow_maps(caster, lights, scale, *rest, **options)

    monkeypatch.setattr("hyjax.scene.scene.cast_shadow_maps", counted)
    monkeypatch.setattr(hyjax.Scene, "surface_light", None)
    draft = np.asarray(pictures.draft(0, second, hyjax.Configuration(), clock))
    assert casts == [0.25] and draft.shape == (24, 32, 3)
    brighter = hyjax.LightSetup.of(hyjax.PointLight(np.array([0.1, -0.4, 2.0]), 999.0, np.ones(3)))
    pictures.draft(0, brighter, hyjax.Configuration(), clock)
    again = np.asarray(pictures.draft(0, first, hyjax.Configuration(), clock))
    assert casts == [0.25]  # those of lights that stand where they stood are kept
    small = np.asarray(whole).reshape(24, 2, 32, 2, 3).mean(axis=(1, 3))
    assert np.abs(again - small).mean() < 0.5 * np.abs(draft - small).mean()


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the stages' functions that were run."""
    found: list[str] = []

    def noted(function: Any, *arrays: Any, **static: Any) -> Any:
        found.append(function.__name__)
        return run_kept(function, *arrays, **static)

    monkeypatch.setattr("hyjax.exploration.kept_stages.run_kept", noted)
    return found


LAMP = hyjax.PointLight(np.array([0.1, -0.4, 2.0]), 777.0, np.ones(3))
WARM = hyjax.PointLight(np.array([-0.6, 0.5, 1.2]), 300.0, np.array([1.0, 0.8, 0.6]))
SKY = hyjax.AmbientLight(30.0, np.ones(3))
CHANGED = {
    "stronger": ((LAMP, WARM, SKY), (replace(LAMP, luminous_flux=999.0), WARM, SKY), True),
    "off": ((LAMP, WARM, SKY), (LAMP, replace(WARM, luminous_flux=0.0), SKY), True),
    "on": ((LAMP, replace(WARM, luminous_flux=0.0), SKY), (LAMP, WARM, SKY), False),
    "other colour": ((LAMP, WARM, SKY), (LAMP, replace(WARM, color=np.array([0.2, 0.8, 1.0])), SKY), False),
    "falls everywhere": ((LAMP, WARM, SKY), (LAMP, WARM, replace(SKY, illuminance=60.0)), False),
    "other place": ((LAMP, WARM, SKY), (replace(LAMP, position=np.array([0.2, -0.4, 2.0])), WARM, SKY), False),
    "fewer": ((LAMP, WARM), (LAMP,), False),
}
"""Lights before, lights after, whether the refined light is scaled."""


@pytest.mark.parametrize("name", CHANGED)
def test_a_draft_of_other_strengths_scales_refined_light(
    name: str, scene: hyjax.Scene, ran: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hyjax.exploration.kept_stages.FEW_NUMBERS", 128)  # pictures are as small here
    before, after, scaled = CHANGED[name]
    first, second = map(hyjax.LightSetup.of, (before, after))
    pictures, clock, configuration = Pictures(scene), StageClock(), hyjax.Configuration()
    pictures.relit(0, first, configuration, clock)
    earlier = np.asarray(pictures.draft(0, first, configuration, clock))
    ran.clear()
    found = np.asarray(pictures.draft(0, second, configuration, clock))
    cascades = {"refine_illuminance", "refine_visibility"}
    assert cascades.isdisjoint(ran) if scaled else cascades <= {*ran}
    fresh = Pictures(scene)
    fresh._whole = pictures._whole  # of its bounces
    np.testing.assert_allclose(found, fresh.draft(0, second, configuration, clock), rtol=1e-5, atol=1e-5)
    assert np.abs(found - earlier).max() > 1e-3 or name == "falls everywhere"  # ambient light is in the bounces


def test_drafts_of_a_kappa_keep_the_shadow_pass(scene: hyjax.Scene, ran: list[str]) -> None:
    pictures, configuration = Pictures(scene), hyjax.Configuration()
    for kappa in np.linspace(0.1, 0.2, 7):
        changed = with_level(configuration, "schedule", 1, "kappa", float(kappa))
        pictures.draft(0, hyjax.LightSetup.of(LAMP), changed, StageClock())
    assert ran.count("refine_visibility") == 1 and ran.count("refine_illuminance") == 7


def test_drafts_have_the_bounces_of_the_picture_that_is_shown(
    scene: hyjax.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    widget = scene.explore(lights="center-point")
    widget.other, widget.view = hyjax.Configuration().with_choices({"bounces": False}), "compare"
    assert widget.wait(120.0) and not widget.message
    followed: list[int] = []
    surface_light = hyjax.Scene.surface_light

    def counted(self: hyjax.Scene, setup: hyjax.LightSetup, **options: Any) -> Any:
        followed.append(len(setup.lights))
        return surface_light(self, setup, **options)

    monkeypatch.setattr(hyjax.Scene, "surface_light", counted)
    moved = hyjax.LightSetup.of(hyjax.PointLight(np.array([0.2, -0.1, 1.9]), 777.0, np.ones(3)))
    widget._pictures.draft(0, moved, widget.configuration, StageClock())
    assert not followed  # those of A, not of B
    widget._pictures.draft(0, "two-colors", widget.configuration, StageClock())
    assert followed == [len(scene.lights("two-colors").lights)]  # other named lights have no bounces of these


def test_drafts_of_all_counts_share_a_program(
    scene: hyjax.Scene, own: hyjax.Configuration, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: set[tuple[int, ...]] = set()

    def noted(lit: Any, configuration: hyjax.Configuration, **_: Any) -> Iterator[tuple[str, Any]]:
        ran.add(tuple(level.steps for level in configuration.schedule.levels))
        yield "composite", lit.view.display

    monkeypatch.setattr("hyjax.exploration.pictures.refine", noted)
    pictures, first = Pictures(scene), with_choice(own, "cascade", "4:6 2:6")
    pictures.fills = True
    for steps in (6, 0, 7, 9, 17, 32):
        pictures.draft(0, "center-point", with_level(first, "schedule", 1, "steps", steps), StageClock())
    assert ran == {(32, 32)}


def test_a_change_of_the_cascade_leaves_the_shadow_pass(
    scene: hyjax.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []

    def counted(function: Any, *arrays: Any, **static: Any) -> Any:
        ran.append(function.__name__)
        return run_kept(function, *arrays, **static)

    monkeypatch.setattr("hyjax.exploration.kept_stages.run_kept", counted)
    pictures = Pictures(scene)
    configuration = hyjax.Configuration()
    for kappa in (0.1, 0.2):
        changed = with_level(configuration, "schedule", 1, "kappa", kappa)
        relit = pictures.relit(0, "center-point", changed, StageClock())
    assert ran.count("refine_visibility") == 1 and ran.count("refine_illuminance") == 2
    assert np.array_equal(relit.image, scene.relit(0, "center-point", changed).image)
    pictures.relit(0, "center-point", with_level(changed, "shadow_schedule", 0, "kappa", 0.3), StageClock())
    assert ran.count("refine_visibility") == 2


def test_older_changes_are_dropped(widget: Explorer, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[float] = []
    go, relit = threading.Event(), widget._pictures.relit

    def slow(frame: int, lights: Any, configuration: hyjax.Configuration, clock: Any) -> hyjax.Relit:
        made.append(float(configuration.schedule.levels[0].kappa))
        go.wait(30.0)
        return relit(frame, lights, configuration, clock)

    monkeypatch.setattr(widget._pictures, "relit", slow)
    for kappa in (0.1, 0.11, 0.12, 0.13, 0.14):
        hand(widget, "level", cascade="schedule", index=0, key="kappa", value=kappa)
        end = time.monotonic() + 30.0
        while not made and time.monotonic() < end:
            time.sleep(0.01)
    go.set()
    assert widget.wait(120.0)
    assert made == pytest.approx([0.1, 0.14])
    expected = relit(0, "center-point", widget.configuration, StageClock())
    assert np.array_equal(widget.relit.image, expected.image)


def test_other_counts_of_steps_are_not_compiled(widget: Explorer, own: hyjax.Configuration) -> None:
    hand(widget, "level", cascade="schedule", index=1, key="kappa", value=0.19)
    assert widget.wait(120.0)
    before = _cascade_known._cache_size()
    widget.configuration = own
    assert widget.wait(120.0)
    hand(widget, "level", cascade="schedule", index=1, key="kappa", value=0.2)
    assert widget.wait(120.0) and _cascade_known._cache_size() == before
    hand(widget, "ready")
    assert widget.wait(120.0)
    before = _cascade_known._cache_size()
    for steps in (4, 5, 8):
        hand(widget, "level", cascade="schedule", index=1, key="steps", value=steps)
        assert widget.wait(120.0)
    assert _cascade_known._cache_size() == before
    images = {}
    for steps in (1, 31, 32, 7, 0):
        hand(widget, "level", cascade="schedule", index=1, key="steps", value=steps)
        assert widget.wait(120.0)
        images[steps] = widget.configuration, widget.relit.image
    assert _cascade_known._cache_size() == before  # whatever the slider says
    for steps in (7, 0):
        configuration, image = images[steps]
        assert np.array_equal(image, widget._scene.relit(0, "center-point", configuration).image)


def test_side_by_side(widget: Explorer) -> None:
    hand(widget, "keep")
    hand(widget, "level", cascade="schedule", index=2, key="kappa", value=0.3)
    widths = {}
    for view in ("compare", "stages", "levels"):
        hand(widget, "view", value=view)
        assert widget.wait(120.0) and not widget.message
        widths[view] = size(widget.sheet)[0]
        sheet = np.asarray(Image.open(io.BytesIO(widget.sheet)))
        assert 30 < sheet.mean() < 225 and sheet[-1, -1].max() < 60  # neither black nor white
    assert widths == {"compare": 1096, "levels": 1096, "stages": 1460}


def test_scores_against_the_truth(scene: hyjax.Scene, own: hyjax.Configuration) -> None:
    asked: list[tuple[int, int]] = []

    def truth(frame: int, setup: hyjax.LightSetup) -> Any:
        asked.append((frame, len(setup.lights)))
        return None if frame == 2 else hyjax.to_display(scene.relit(frame, setup, own).image)

    widget = hyjax.explore(scene, lights="center-point", configuration=own, truth=truth)
    assert widget.wait(120.0) and asked == [(0, 1)]
    (perfect,) = widget.scores
    assert perfect["name"] == own.name and perfect["loss"] < 1e-3 and perfect["ssim"] > 0.999
    assert widget.judged[0].startswith(f"{own.name}: loss 0.000") and "SSIM 1.0000" in widget.judged[0]
    widget.other, widget.configuration = own, own.with_choices({"bounces": False, "sampling": 1})
    widget.view = "compare"
    assert widget.wait(120.0)
    first, second = widget.scores
    assert first["name"] == f"A: {widget.configuration.name}" and second["name"] == f"B: {own.name}"
    assert second["loss"] < 0.5 * first["loss"] and first["psnr_raw"] < second["psnr_raw"]
    widget.view = "truth"
    assert widget.wait(120.0) and size(widget.sheet)[0] == 1096
    widget.frame = 2
    assert not widget.wait(120.0)  # there is nothing to show beside it
    assert widget.scores == [] and "no truth is known" in widget.judged[0]


def test_a_picture_is_judged_under_its_own_lights(
    scene: hyjax.Scene, own: hyjax.Configuration, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[hyjax.LightSetup] = []
    widget = hyjax.explore(
        scene, lights="center-point", configuration=own, truth=lambda _, setup: asked.append(setup)
    )
    assert widget.wait(120.0)
    monkeypatch.setattr(widget._newest, "request", lambda **_: None)  # of the next lights is no picture yet
    widget.lights = hyjax.LightSetup.of(hyjax.PointLight(np.array([0.1, -0.4, 2.0]), 700.0, np.ones(3)))
    widget._judge(False)
    first, second = asked
    assert same_setup(first, second) and not same_setup(second, widget.lights)


@pytest.mark.parametrize("early", [False, True])
def test_an_older_judgement_fails_no_newer_picture(
    scene: hyjax.Scene, own: hyjax.Configuration, monkeypatch: pytest.MonkeyPatch, early: bool
) -> None:
    """Whether it fails before the newer picture is made, or later."""
    begun, go = threading.Event(), threading.Event()

    def truth(frame: int, _: hyjax.LightSetup) -> None:
        if frame == 1:
            begun.set()
            go.wait(30.0)
            raise hyjax.InputError("of a test")

    widget = hyjax.explore(scene, lights="center-point", configuration=own, truth=truth)
    assert widget.wait(120.0)
    widget.frame = 1
    assert begun.wait(120.0)
    relit = widget._pictures.relit

    def later(*arguments: Any) -> hyjax.Relit:
        if early:
            go.set()
            assert widget._judging.wait(30.0) and widget._failed
        return relit(*arguments)

    monkeypatch.setattr(widget._pictures, "relit", later)
    widget.frame = 2
    assert widget._newest.wait(120.0)
    go.set()
    assert widget.wait(120.0) and widget.relit is not None
    assert early or not widget.message


def test_a_truth_of_another_size_is_said(scene: hyjax.Scene, own: hyjax.Configuration) -> None:
    widget = hyjax.explore(scene, lights="center-point", configuration=own, truth=lambda *_: np.zeros((4, 4, 3)))
    assert not widget.wait(120.0)
    assert "truth: must be a picture of (48, 64, 3), got (4, 4, 3)" in widget.message


def test_the_truth_of_a_room_is_that_of_named_lights(scene: hyjax.Scene) -> None:
    class Room(TruthCapture):
        def __init__(self) -> None: ...

        def picture(self, index: int) -> Frame:
            return scene.capture.picture(index)

        def truth(self, setup: Any, frames: Any, light: Any = None) -> Any:
            return [np.full((48, 64, 3), 0.25 * (1 + n), np.float32) for n in frames]

    room: Any = SimpleNamespace(capture=Room(), size=(24, 32))
    known, setup = KnownTruth(room), scene.lights("center-point")
    assert known.known and not KnownTruth(scene).known
    picture = known.picture(1, "center-point", setup, (24, 32, 3))
    assert picture is not None and picture == pytest.approx(np.full((24, 32, 3), 0.5), abs=0.01)
    assert known.picture(1, setup, setup, (24, 32, 3)) is None


def test_there_is_no_view_of_a_truth_that_is_not_known(widget: Explorer) -> None:
    with pytest.raises(hyjax.InputError, match="view: must be one of wipe"):
        widget.view = "truth"
    assert "truth" not in widget.state["views"] and widget.scores == [] == widget.judged


def test_a_sheet_that_cannot_be_made_leaves_the_picture(widget: Explorer) -> None:
    before = widget.relit
    hand(widget, "view", value="levels")
    widget.configuration = "paper"
    assert not widget.wait(120.0)
    assert "paper" in widget.message and widget.sheet == b""
    assert widget.relit is not before and 'preset("paper")' in widget.code
    data, _ = widget._repr_mimebundle_()
    assert base64.b64decode(data["image/jpeg"]) == widget.picture
    hand(widget, "view", value="wipe")
    assert widget.wait(120.0) and not widget.message


def test_its_script_makes_the_same_picture(
    widget: Explorer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand(widget, "level", cascade="schedule", index=1, key="steps", value=7)
    hand(widget, "strength", index=0, value=321.0)
    hand(widget, "place", index=0, value=[0.4, 0.3])
    hand(widget, "choice", name="bounces", value=False)
    assert widget.wait(120.0)
    monkeypatch.chdir(tmp_path)
    exec(widget.code, places := {"scene": widget._scene})  # a scene without settings
    assert np.array_equal(places["relit"].image, widget.relit.image)
    assert (tmp_path / "relit.png").is_file()


@pytest.mark.slow
def test_its_script_runs_by_itself(own: hyjax.Configuration, tmp_path: Path) -> None:
    """In a process of its own, on a capture that is opened there."""
    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    scan = export_arkit_scan(tmp_path / "arkit", room, room.reference())
    scene = hyjax.Scene.open(hyjax.SceneSettings(capture=scan, size="64x48"))
    widget = scene.explore(frame=1, lights="center-point", configuration=own)
    hand(widget, "ready")
    hand(widget, "level", cascade="schedule", index=0, key="steps", value=6)
    hand(widget, "strength", index=0, value=654.0)
    assert widget.wait(120.0)
    (tmp_path / "script.py").write_text(widget.code)
    subprocess.run([sys.executable, "script.py"], cwd=tmp_path, check=True, timeout=600)
    relit = np.asarray(hyjax.to_display(widget.relit.image))
    assert np.array_equal(np.round(255 * read_image(tmp_path / "relit.png")), np.round(255 * relit.clip(0, 1)))


def test_the_last_picture_is_kept_beside_the_widget(widget: Explorer) -> None:
    data, _ = widget._repr_mimebundle_()
    assert size(base64.b64decode(data["image/jpeg"])) == (64, 48)
    assert data["text/plain"].startswith("Explorer: frame 0, center-point")
    assert "application/vnd.jupyter.widget-view+json" in data
