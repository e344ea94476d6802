"""Relighter: the command, Python's lines and a scene's parts make one picture."""

import dataclasses
import functools
import json
import time
from pathlib import Path
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference.arkit_export import export_arkit_scan

import hyjax
from hyjax.configuration import Configuration
from hyjax.data.builtin_room import load_room
from hyjax.guide.choose import configured_guide
from hyjax.pipeline import cascade_calls, relight
from hyjax.relighting import ahead
from hyjax.relighting.each_light import relight_each
from hyjax.relighting.run import relight_capture
from hyjax.relighting.settings import RelightSettings
from hyjax.util import programs
from hyjax.util import quick_programs as quick_programs_module
from hyjax.util.images import read_image
from hyjax.util.quick_programs import optimise_programs, quick_programs

OWN = {
    "scale": 2,
    "sampling": 1,
    "bounces": False,
    "photo_exponent": 1.3,
    "map_scale": 0.5,
    "views": 4,
    "least_share": 0.05,
}


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    room = load_room(n_frames=4, width=160, height=120, quality=0.25, progress=False)
    mesh = hyjax.Scene.open(hyjax.SceneSettings(), capture=room).mesh
    return export_arkit_scan(tmp_path_factory.mktemp("scan"), room, mesh)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["default", "fast", "paper", "own"])
def test_readmes_lines_make_the_picture_of_the_command(
    name: str, capture: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = name
    if name == "own":
        (tmp_path / "own.json").write_text(Configuration(name="own").with_choices(OWN).to_json())
        text = str(tmp_path / "own.json")
    settings = hyjax.SceneSettings(capture=capture, size="160x120")
    run = hyjax.relight_capture(
        hyjax.RelightSettings(
            settings,
            frames="0",
            lights="evening-lamps",
            configuration=None if name == "default" else text,
            sampling=2 if name == "paper" else None,
            out=tmp_path / "out",
            quiet=True,
        )
    )
    scene = hyjax.Scene.open(settings)
    relit = scene.relit(0, "evening-lamps") if name == "default" else scene.relit(0, "evening-lamps", text)
    hyjax.write_png(tmp_path / "relit.png", hyjax.to_display(relit.image))
    written = read_image(tmp_path / "out" / f"{run['frames'][0]}.relit.png")
    np.testing.assert_array_equal(read_image(tmp_path / "relit.png"), written)
    assert run["sampling"] == Configuration.of(text).light.sampling
    assert ("sampling: 2 asked" in caplog.text) == (name == "paper")


@pytest.mark.slow
def test_stages_end_in_the_relit_frame(capture: Path) -> None:
    scene = hyjax.Scene.open(hyjax.SceneSettings(capture=capture, size="160x120"))
    relighter = hyjax.Relighter(scene, "two-colors", "fast")
    stages = dict(relighter.stages(1))
    assert list(stages)[:2] == ["g-buffer", "view"] and list(stages)[-1] == "comparison"
    np.testing.assert_array_equal(stages["comparison"].image, relighter.relit(1).image)
    np.testing.assert_array_equal(relighter.picture(scene.frame(1)), relighter.relit(1).image)
    shaded = relighter.shade(relighter.view(1))
    np.testing.assert_array_equal(shaded.illuminance, stages["shaded"].illuminance)


@pytest.mark.slow
@pytest.mark.parametrize("ambient", [0, 1])
def test_light_that_bounces_stand_in_for_is_refined_in_no_channel(ambient: int, capture: Path) -> None:
    """The picture is that of all channels, of which the ambient light's is zero."""
    scene = hyjax.Scene.open(hyjax.SceneSettings(capture=capture, size="160x120"))
    setup = hyjax.LightSetup.of(
        [
            hyjax.PointLight(jnp.array([2.0, 2.5, 2.0]), jnp.float32(600.0), jnp.array([1.0, 0.5, 0.2])),
            hyjax.AmbientLight(jnp.float32(50.0), jnp.array([0.2, 0.4, 1.0])),
        ][:: 1 - 2 * (ambient == 0)]
    )
    relighter = hyjax.Relighter(scene, setup)
    view, few = relighter.view(0), relighter.lit(0).shaded
    shaded = relighter.shade(view)
    assert shaded.illuminance.shape[-1] == 2 and few.illuminance.shape[-1] == len(few.colors) == 1
    assert float(shaded.illuminance[..., ambient].max()) == 0 < float(few.illuminance.max())
    lit = relighter.lit(0)
    assert lit.light_edges is not None
    own = relighter.configuration.sampled()
    whole = relight(
        view, shaded, view.display, own.schedule,
        shadow_schedule=own.shadow_schedule, light_edges=lit.light_edges,
    )  # fmt: skip
    np.testing.assert_allclose(relighter.picture(0), whole.image, atol=2e-6)
    shown = hyjax.Relighter(scene, setup, shader=lambda view, camera, light: (view, few))
    assert shown.lit(0).shaded is few, "a shader's channels are its own"
    plain = hyjax.Relighter(scene, setup, Configuration().with_choices({"bounces": False}))
    assert plain.lit(0).shaded.illuminance.shape[-1] == 2


@pytest.mark.slow
@pytest.mark.parametrize("photo_light", ["divided", "kept"])
def test_programs_that_are_begun_are_those_that_run(
    photo_light: str, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = hyjax.Scene.open(hyjax.SceneSettings(capture=capture, size="160x120"))
    configuration = Configuration().with_choices({"photo_light": photo_light})
    begun: list[Any] = []
    monkeypatch.setattr(programs, "_folder", tmp_path)
    monkeypatch.setattr(ahead, "make_ready", lambda function, *arrays: begun.append(_shapes(function, arrays)))
    setup = scene.lights("evening-lamps", at_photo_sources=photo_light == "divided")
    ahead.begin_programs(scene, [0], setup, configuration, configured_guide(configuration.guide), video=False)
    run: list[Any] = []
    relighter = hyjax.Relighter(scene, setup, configuration)
    lit, own = relighter.lit(0), configuration.sampled()
    for call in cascade_calls(lit.shaded, lit.features, own.schedule, own.shadow_schedule):
        run.append(_shapes(call[0], call[1:]))
    deadline = time.monotonic() + 60
    while len(begun) < 3 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert all(call in begun for call in run) and len(begun) == 3


@pytest.mark.slow
def test_a_first_frame_is_refined_by_programs_of_more_lights(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where its own are not kept, and without a change of the picture."""
    scene = hyjax.Scene.open(hyjax.SceneSettings(capture=capture, size="160x120"))
    lamps = [hyjax.PointLight(np.array([1.5 + k, 2.5, 2.0]), 600.0, np.array([1.0, 0.6, 0.3])) for k in range(3)]
    configuration, begin = Configuration(), functools.partial(ahead.begin_programs, scene, [0])
    settings = configuration, configured_guide(configuration.guide)
    monkeypatch.setattr(programs, "_functions", {})
    monkeypatch.setattr(programs, "_folder", tmp_path)
    monkeypatch.setattr(ahead, "make_ready", lambda *call: None)
    few, own = hyjax.LightSetup.of(lamps[:1]), configuration.sampled()

    def keep_cascades(setup: hyjax.LightSetup) -> None:
        lit = hyjax.Relighter(scene, setup, configuration).lit(0)
        for call in cascade_calls(lit.shaded, lit.features, own.schedule, own.shadow_schedule):
            programs.make_ready(*call)

    with quick_programs():
        assert begin(few, *settings, video=False).count == 0, "nothing is kept"
    keep_cascades(hyjax.LightSetup.of(lamps))
    assert begin(few, *settings, video=False).count == 0, "all programs are optimised"
    with quick_programs():
        dark = begin(few, *settings, video=False)
        assert dark.count == 2
        assert begin(few, *settings, video=True).count == begin(few, *settings, video=False, exact=True).count == 0
    monkeypatch.setattr(programs, "_folder", None)
    relighter = hyjax.Relighter(scene, few, configuration)
    plain = relighter.relit(0)
    relighter.dark_lights = 2
    assert relighter.lit(0).shaded.illuminance.shape[-1] == 3
    for with_dark, without in zip(jax.tree.leaves(relighter.relit(0)), jax.tree.leaves(plain), strict=True):
        np.testing.assert_allclose(with_dark, without, atol=2e-6)
    monkeypatch.setattr(programs, "_folder", tmp_path)
    with quick_programs():
        optimise_programs()
        dark.drop_later(relighter)
        deadline = time.monotonic() + 60
        while relighter.dark_lights and time.monotonic() < deadline:
            time.sleep(0.01)
        assert relighter.dark_lights == begin(few, *settings, video=False).count == 0, "its own are kept"
    assert all(programs.kept_function(function).is_kept(*arrays) for function, *arrays in dark.cascades)


@pytest.mark.slow
@pytest.mark.parametrize("first", ["seen", "without surface"])
def test_a_run_begins_with_dark_lights_and_drops_them(
    first: str, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where its first frame sees no surface."""
    settings, counts = hyjax.SceneSettings(capture=capture, size="160x120"), list[int]()
    lamps = [hyjax.PointLight(np.array([1.5 + k, 2.5, 2.0]), 600.0, np.array([1.0, 0.6, 0.3])) for k in range(3)]
    scene, configuration = hyjax.Scene.open(settings), Configuration()
    own, lit = configuration.sampled(), hyjax.Relighter(scene, lamps, configuration).lit(0)
    monkeypatch.setattr(programs, "_folder", tmp_path / "programs")
    monkeypatch.setattr(programs, "_functions", {})
    for call in cascade_calls(lit.shaded, lit.features, own.schedule, own.shadow_schedule):
        programs.make_ready(*call)

    def counted(relighter: hyjax.Relighter, frame: Any, **options: Any) -> Any:
        counts.append(relighter.dark_lights)
        return stages(relighter, frame, **options)

    def dropped_at_once(task: Any) -> None:
        assert quick_programs_module._optimiser is not None
        task()

    def gbuffer(relighter: hyjax.Relighter, camera: Any, **options: Any) -> Any:
        made = seen(relighter, camera, **options)
        blind = first != "seen" and not cameras
        cameras.append(camera)
        return dataclasses.replace(made, hit=jnp.zeros_like(made.hit)) if blind else made

    stages, seen, cameras = hyjax.Relighter.stages, hyjax.Relighter.gbuffer, list[Any]()
    monkeypatch.setattr(hyjax.Relighter, "stages", counted)
    monkeypatch.setattr(hyjax.Relighter, "gbuffer", gbuffer)
    monkeypatch.setattr(ahead, "submit", dropped_at_once)
    run = relight_capture(
        RelightSettings(settings, frames="0:3", out=tmp_path / "out", quiet=True), scene=scene, lights=lamps[:1]
    )
    assert len(run["frames"]) == (3 if first == "seen" else 2)
    assert counts == ([2, 0, 0] if first == "seen" else [0, 0])


def _shapes(function: Any, arrays: Any) -> tuple[Any, ...]:
    leaves, tree = jax.tree.flatten(arrays)
    return function, tree, *((np.shape(leaf), jnp.result_type(leaf)) for leaf in leaves)


class Lights:
    """Place that takes lights as they are."""

    knows_photo_light, revision = False, 1

    def lights(self, lights: hyjax.LightSetup, *, at_photo_sources: bool = False) -> hyjax.LightSetup:
        return hyjax.LightSetup.of(lights)


def test_traced_lights_are_one_line() -> None:
    def relighter(flux: jax.Array) -> hyjax.Relighter:
        light = hyjax.PointLight(jnp.array([0.0, 0.0, 2.0]), flux, jnp.ones(3))
        return hyjax.Relighter(cast(Any, Lights()), [light], "paper")

    with pytest.raises(hyjax.InputError, match=r"cast them first .scene.shadow_maps.") as caught:
        jax.grad(lambda flux: relighter(flux).configuration.scale * flux)(800.0)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("choices", [{}, {"photo_light": "kept"}])
def test_pictures_of_single_lamps_add_up(choices: dict[str, Any], capture: Path) -> None:
    """As the page about robot data promises: without ambient light, and without panes in the picture."""
    scene = hyjax.Scene.open(hyjax.SceneSettings(capture=capture, size="160x120"))
    lamps = [
        hyjax.PointLight(np.array(position), 600.0, hyjax.blackbody(kelvin))
        for position, kelvin in (([2.0, 2.5, 2.0], 2700.0), ([3.0, 1.0, 1.5], 6500.0))
    ]
    chosen = Configuration().with_choices(choices)
    whole, *single = (np.asarray(scene.relit(0, lights, chosen).image) for lights in (lamps, *([x] for x in lamps)))
    assert whole.max() > 0.05
    np.testing.assert_allclose(sum(single), whole, atol=2e-5)


@pytest.mark.slow
def test_each_light_by_itself_leaves_pictures_that_add_up(
    capture: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    lamps: list[dict[str, Any]] = [
        {"kind": "point", "position": [2.0, 2.5, 2.0], "luminous_flux": 15000},
        {"kind": "spot", "position": [3.0, 1.0, 2.0], "target": [2.0, 2.0, 0.0], "luminous_flux": 400},
    ]
    (tmp_path / "lamps.json").write_text(json.dumps({"lights": lamps}))
    (tmp_path / "more.json").write_text(json.dumps({"lights": [*lamps, {"kind": "ambient", "illuminance": 20}]}))
    how = {"scene": hyjax.SceneSettings(capture=capture, size="160x120"), "frames": "0", "exr": True, "quiet": True}
    how["choices"] = ("least_share=0.05",)  # a light as weak as the spot has no shadow beside the other
    settings = RelightSettings(lights=str(tmp_path / "more.json"), each_light=True, out=tmp_path / "each", **how)
    with pytest.raises(hyjax.InputError, match="call relight_each"):
        relight_capture(settings)
    caplog.set_level("WARNING", "hyjax")
    runs = relight_each(dataclasses.replace(settings, each_light=False))
    assert runs[settings.out / "1-spot"]["frames_too_dark"] and "nearly black" not in caplog.text
    assert [folder.name for folder in runs] == ["0-point", "1-spot"]
    for folder, run in runs.items():
        assert json.loads((folder / "run.json").read_text()) == run
        told = {"capture": str(capture), "lights": settings.lights, "size": "160x120", "out": str(folder)}
        assert run["settings"].items() >= told.items()
    together = RelightSettings(lights=str(tmp_path / "lamps.json"), out=tmp_path / "together", **how)
    relight_capture(together)
    (without_shadow,) = (read_image(file) for file in together.out.glob("*.exr"))
    relight_capture(dataclasses.replace(together, choices=("least_share=0",)))
    (whole,) = (read_image(file) for file in together.out.glob("*.exr"))
    assert np.abs(without_shadow - whole).max() > 1e-3
    single = [read_image(file) for folder in runs for file in folder.glob("*.exr")]
    assert min(picture.max() for picture in single) > 0.01
    np.testing.assert_allclose(sum(single), whole, rtol=2e-3, atol=1e-4)
    (tmp_path / "each" / "2-point").mkdir()  # as an earlier run with one lamp more left it
    with pytest.raises(hyjax.InputError, match="2-point is of an earlier run's light"):
        relight_each(settings)
    paper = dataclasses.replace(settings, paper_mode=True, choices=())
    with pytest.raises(hyjax.InputError, match="each_light: pictures of paper mode do not add up"):
        relight_each(paper)
