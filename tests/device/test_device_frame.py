"""Whole frames by WebGPU against `hyjax.relight`: the same lights, the same picture."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import OpenImageIO as oiio
import pytest
from scipy import ndimage

import hyjax
from hyjax.configuration import LightOptions
from hyjax.core.schedule import Schedule
from hyjax.data.light_file import write_lights
from hyjax.device.light_records import light_records
from hyjax.device.renderer import DeviceRenderer
from hyjax.device.scene_arrays import tree_order
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.kinds import (
    LIGHT_KINDS,
    AmbientLight,
    Aperture,
    DirectionalLight,
    Light,
    PointLight,
    RectLight,
    SkyLight,
    SpotLight,
)
from hyjax.light.panes import NO_BAR
from hyjax.light.setup import LightSetup
from hyjax.light.shading import shade_each
from hyjax.light.shadow_map import visibilities
from hyjax.relighting.run import relight_capture
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.kept_maps import KeptMaps
from hyjax.scene.scene import Scene
from hyjax.scene.settings import SceneSettings
from hyjax.util.errors import InputError

SIZE, TEXELS = (72, 96), (128, 64)
SIZE_TEXT = "96x72"
MARGIN = 0.15
"""Metres before a surface at which something throws a shadow on it for certain."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    from hyjax.data.builtin_room import load_room

    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    return Scene.open(SceneSettings(size=SIZE_TEXT), capture=room)


def all_kinds(scene: Scene) -> LightSetup:
    """A light of every kind, with and without an extent, through an opening and not."""
    low, high = scene.mesh.bounds
    up = np.asarray(scene.capture.up, np.float32)
    middle = ((low + high) / 2).astype(np.float32)
    white, down = np.ones(3, np.float32), -up
    panel = Aperture.facing(middle + 0.4 * up, down, np.array([1.0, 0.2, 0.1]), 0.8, 0.5)
    slanted = (down + np.array([0.3, 0.2, 0.0])).astype(np.float32)

    def f(value: Any) -> np.ndarray:
        return np.asarray(value, np.float32)

    lights = (
        PointLight(middle, f(800.0), white),
        PointLight(middle + 0.2 * up, f(500.0), f([1.0, 0.5, 0.2]), f(0.05), f(0.02)),
        SpotLight(middle, down, f(900.0), white, f(0.4), f(0.7)),
        SpotLight(middle, slanted, f(900.0), white, f(0.9), f(1.3), f(0.04)),
        RectLight.filling(panel, f(600.0), f([0.3, 0.6, 1.0])),
        DirectionalLight(slanted, f(200.0), white, f(0.0047)),
        DirectionalLight(slanted, f(900.0), white, f(0.0), panel),
        SkyLight(up, f(80.0), white),
        AmbientLight(f(50.0), white),
    )
    return LightSetup(lights, 250.0)


def test_every_kind_has_a_shader(scene: Scene) -> None:
    assert {type(light) for light in all_kinds(scene).lights} == set(LIGHT_KINDS.values())


def reference(scene: Scene, setup: LightSetup, index: int, keep: bool) -> tuple[hyjax.View, Any, hyjax.Relit]:
    """View, light and relit picture by JAX, with shadow maps of the size that the shaders fill."""
    maps = cast_shadow_maps(scene.occluders, setup.lights, scale=TEXELS[0] / 1024, slack=scene.slack)
    scene.kept_maps = KeptMaps()
    scene.kept_maps.of(("completed", 1.0, None), setup.lights, lambda _: maps)
    view = scene.view(index)
    shaded = scene.shade(view, setup, keep_photo_light=keep)
    return view, shaded, hyjax.relight(view, shaded, view.display, Schedule.preset("hyjax"))


def renderer_of(scene: Scene, setup: LightSetup, device: Any, keep: bool, **options: Any) -> DeviceRenderer:
    return DeviceRenderer(
        scene,
        setup,
        SIZE,
        Schedule.preset("hyjax"),
        light=LightOptions(photo_light="kept" if keep else "divided"),
        resolutions=TEXELS,
        device=device,
        **options,
    )


def raw_visibility(renderer: DeviceRenderer, count: int) -> list[np.ndarray]:
    """Visibility of each light before it is repaired, and its weights."""
    groups = -(-count // 4)
    planes = renderer.engine.download("light").reshape(-1, *SIZE, 4)[2 + groups :]
    return [np.moveaxis(half, 0, 2).reshape(*SIZE, -1)[..., :count] for half in (planes[:groups], planes[groups:])]


@pytest.mark.slow
def test_lights_of_every_kind(scene: Scene, device: Any) -> None:
    """Illuminance and visibility of each light at each pixel; where a ray grazes an edge they may differ."""
    setup = all_kinds(scene)
    renderer = renderer_of(scene, setup, device, keep=True)
    view, _, relit = reference(scene, setup, 0, keep=True)
    picture = renderer.relight(np.asarray(view.display), scene.frame(0).camera)
    count = len(setup.lights)
    raw = renderer.picture("raw", 8 + count)[..., 8:] * setup.reference_lux
    expected = np.asarray(shade_each(view.gbuffer, setup.lights))
    assert np.quantile(np.abs(raw - expected) / (1.0 + expected), 0.99) < 1e-4
    values, known = raw_visibility(renderer, count)
    maps = scene.shadow_maps(setup)
    seen = np.asarray(visibilities(view.gbuffer, setup.lights, maps))
    for k, light in enumerate(setup.lights):
        lit = known[..., k] > 0
        assert lit.any(), type(light).__name__
        assert np.abs(values[..., k] - seen[..., k])[lit].mean() < 2e-3, type(light).__name__
    assert np.abs(picture - np.asarray(relit.image)).mean() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("lights", ["evening-lamps", "golden-hour"])
@pytest.mark.parametrize("keep", [True, False])
def test_whole_frame(scene: Scene, device: Any, lights: str, keep: bool) -> None:
    setup = scene.lights(lights, at_photo_sources=not keep)
    renderer = renderer_of(scene, setup, device, keep)
    for index in (0, 2):
        view, _, relit = reference(scene, setup, index, keep)
        frame = scene.frame(index)
        found = renderer.relit(frame.image, frame.camera, view.display)
        assert np.abs(np.asarray(found.image) - np.asarray(relit.image)).mean() < 2e-3
        for stage in ("shading", "refined", "visibility", "relight_filter", "unrefined"):
            expected = np.asarray(getattr(relit, stage))
            error = np.abs(np.asarray(getattr(found, stage)) - expected).mean()
            assert error < 4e-3 * max(1.0, expected.mean()), stage


@pytest.mark.slow
@pytest.mark.parametrize("is_on", [False, True])
def test_a_lamps_rim_goes_out_with_it(is_on: bool, tmp_path: Path, device: Any) -> None:
    """Its pixels are mixed with what lies behind it, and less bright; they shine no more than in the photo."""
    from hyjax.data.builtin_room import load_room

    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    file = tmp_path / "sources.yaml"
    lamp, radius = np.asarray(room.anchors["lamp_0"]["position"], float), 0.25
    file.write_text(f"lamps: [{{position: {lamp.tolist()}, radius: {radius}}}]")
    scene = Scene.open(SceneSettings(size=SIZE_TEXT, photo_sources=file), capture=room)
    white = np.ones(3, np.float32)
    bulb = PointLight(lamp.astype(np.float32), np.float32(200.0), white, 0.05)
    setup = LightSetup((AmbientLight(np.asarray(150.0, np.float32), white), *[bulb][: int(is_on)]), 300.0)
    frame = scene.frame(0)
    (x, y), depth = frame.camera.project(lamp)
    assert depth > 0.5 and 8 < x < SIZE[1] - 8 and 8 < y < SIZE[0] - 8
    columns, rows = np.meshgrid(np.arange(SIZE[1]) + 0.5, np.arange(SIZE[0]) + 0.5)
    away = np.maximum(np.abs(columns - x), np.abs(rows - y))
    photo = np.array(frame.image)
    photo[away < 4], photo[away < 3] = 0.93 if is_on else 0.8, 1.0
    view = dataclasses.replace(scene.view(0), frame=hyjax.to_linear(jnp.asarray(photo)))
    expected = np.asarray(
        hyjax.relight(view, scene.shade(view, setup), view.display, Schedule.preset("hyjax")).image
    )
    found = renderer_of(scene, setup, device, keep=False).relight(photo, frame.camera)
    rim = (away < 4) & (away >= 3)
    assert np.abs(found - expected)[rim].max() < 0.02
    if is_on:
        assert expected[rim].mean() < 0.9 * expected[away < 3].mean()
    else:
        assert expected[rim].max() < 0.8 * np.asarray(view.frame)[rim].min(), "it is off"


@pytest.mark.slow
def test_bars_of_windows_do_not_shine(scene: Scene, device: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bars of both directions, behind the pane, as JAX leaves them out."""
    photo_light = scene.photo_light
    estimate, panes = photo_light._stored
    count = len(panes["bar_recess"])
    bars = [[(-0.5, 0.1), (0.3, 0.16)], [(0.2, 0.12), (0.0, NO_BAR)]]
    barred = panes | {
        "bar_spans": np.tile(np.array(bars, np.float32), (count, 1, 1, 1)),
        "bar_recess": np.full(count, 0.15, np.float32),
    }
    setup, pictures = scene.lights("two-colors", at_photo_sources=True), {}
    index = int(np.argmax([_pane_pixels(scene, setup, index) for index in range(4)]))
    frame = scene.frame(index)
    for name, own in (("whole", panes | {"bar_spans": barred["bar_spans"][:, :, :0]}), ("barred", barred)):
        monkeypatch.setitem(photo_light.__dict__, "_stored", (estimate, own))
        monkeypatch.setattr(photo_light, "_last", None)
        view, _, relit = reference(scene, setup, index, keep=False)
        found = renderer_of(scene, setup, device, keep=False).relight(np.asarray(view.display), frame.camera)
        pictures[name] = np.asarray(relit.image), found
    changed = np.abs(pictures["barred"][0] - pictures["whole"][0]).max(axis=-1) > 0.05
    assert 20 < changed.sum() < changed.size / 3
    for expected, found in pictures.values():
        assert np.abs(found - expected)[changed].mean() < 0.02
    assert pictures["barred"][1][changed].mean() > 2 * pictures["whole"][1][changed].mean(), "panes are dark"


def _pane_pixels(scene: Scene, setup: LightSetup, index: int) -> float:
    """Pixels of a frame that belong to panes."""
    shining = scene.shade(scene.view(index), setup).emission
    return 0.0 if shining is None else float(shining.weight.sum())


def test_half_precision_of_a_frame(scene: Scene, device: Any) -> None:
    if "shader-f16" not in device.features:
        pytest.skip("this adapter has no half precision")
    setup = scene.lights("evening-lamps", at_photo_sources=True)
    renderer = renderer_of(scene, setup, device, False, precision="f16")
    view, _, relit = reference(scene, setup, 0, keep=False)
    found = renderer.relight(np.asarray(view.display), scene.frame(0).camera)
    assert np.abs(found - np.asarray(relit.image)).mean() < 2e-3


def test_features_of_a_network(scene: Scene, device: Any) -> None:
    setup = scene.lights("noon-window")
    renderer = renderer_of(scene, setup, device, True, features=6)
    view, shaded, _ = reference(scene, setup, 1, keep=True)
    guide = jnp.concatenate([view.display, 0.5 * view.display[..., ::-1]], axis=-1)
    expected = hyjax.relight(view, shaded, guide, Schedule.preset("hyjax"))
    found = renderer.relight(np.asarray(view.display), scene.frame(1).camera, guide)
    assert np.abs(found - np.asarray(expected.image)).mean() < 2e-3


def test_a_camera_that_sees_nothing(scene: Scene, device: Any) -> None:
    """Only ambient light is used, as `relight` does; and the run would skip such a frame."""
    setup = LightSetup((AmbientLight(np.asarray(150.0, np.float32), np.ones(3, np.float32)),), 300.0)
    renderer = renderer_of(scene, setup, device, keep=True)
    frame = scene.frame(0)
    pose = frame.camera.pose.copy()
    pose[:3, 3] += 1000.0
    picture = renderer.relight(frame.image, dataclasses.replace(frame.camera, pose=pose))
    assert not renderer.sees_surface
    assert np.abs(picture - 0.5 * np.asarray(hyjax.to_linear(jnp.asarray(frame.image)))).max() < 1e-5


def test_tree_order_keeps_every_triangle(scene: Scene) -> None:
    faces = np.asarray(scene.mesh.faces)
    order = tree_order(np.asarray(scene.mesh.vertices), faces)
    assert sorted(map(tuple, order)) == sorted(map(tuple, faces))


def test_lights_without_a_shader(scene: Scene) -> None:
    class Glow(Light):
        KEYS = ()
        STRENGTH = "color"

    with pytest.raises(InputError, match="no shader for a Glow"):
        light_records([Glow()], scene.mesh)
    lamp = PointLight(np.zeros(3, np.float32), np.asarray(1.0, np.float32), np.ones(3, np.float32))
    with pytest.raises(InputError, match="at most 32"):
        light_records([lamp] * 33, scene.mesh)


@pytest.mark.slow
def test_relight_by_webgpu(scene: Scene, device: Any, tmp_path: Path) -> None:
    """The command's pictures are those of the other renderer."""
    write_lights(tmp_path / "lamp.json", LightSetup((all_kinds(scene).lights[0],), 250.0))
    images = {}
    for renderer in ("webgpu", "shadow_map"):
        out = tmp_path / renderer
        options = {
            "lights": str(tmp_path / "lamp.json"),
            "frames": "0",
            "keep_photo_light": True,
            "exr": True,
            "quiet": True,
        }
        settings = RelightSettings(SceneSettings(size=SIZE_TEXT), renderer=renderer, out=out, **options)
        run = relight_capture(settings, scene=scene)
        assert run["renderer"] == renderer and json.loads((out / "run.json").read_text())["frames"] == run["frames"]
        images[renderer] = oiio.ImageBuf(str(out / f"{run['frames'][0]}.relit.exr")).get_pixels()
        assert (out / "contact_sheet.png").is_file()
    assert np.abs(images["webgpu"] - images["shadow_map"]).mean() < 2e-3


def test_webgpu_does_no_video() -> None:
    with pytest.raises(InputError, match="renderer: webgpu"):
        RelightSettings(renderer="webgpu", video=True).check()


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.0, 0.05])
def test_light_does_not_leak(scene: Scene, device: Any, radius: float) -> None:
    """Where rays say that something stands well before the surface, full shadow maps are dark, too."""
    low, high = scene.mesh.bounds
    up = np.asarray(scene.capture.up, np.float32)
    place = ((low + high) / 2 + [0.3, 0.2, 0.0] - 0.25 * np.linalg.norm(high - low) * 0.5 * up).astype(np.float32)
    flux, size = np.asarray(800.0, np.float32), np.asarray(radius, np.float32)
    lamp = PointLight(place, flux, np.ones(3, np.float32), size)
    renderer = DeviceRenderer(
        scene,
        LightSetup((lamp,), 250.0),
        SIZE,
        Schedule.preset("hyjax"),
        device=device,
        light=LightOptions(photo_light="kept"),
    )
    leaks = shaded = 0
    for index in range(4):
        view = scene.view(index)
        renderer.relight(np.asarray(view.display), scene.frame(index).camera)
        seen, lit = (values[..., 0] for values in raw_visibility(renderer, 1))
        offset = np.asarray(view.gbuffer.position).reshape(-1, 3) - place
        distance = np.linalg.norm(offset, axis=-1)
        met = scene.occluders.cast(np.broadcast_to(place, offset.shape), offset / distance[:, None]).distance
        dark = (np.asarray(met) < distance - MARGIN).reshape(SIZE) & np.asarray(view.gbuffer.hit)
        core = ~ndimage.binary_dilation(~dark, iterations=2) & (lit > 0)
        leaks, shaded = leaks + int((seen[core] > 0.5).sum()), shaded + int(core.sum())
    print(f"{leaks} of {shaded} pixels")
    assert shaded > 300 and leaks <= 0.01 * shaded
