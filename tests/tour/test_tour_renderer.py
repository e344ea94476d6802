"""Renderer: the same pictures as `hyjax relight`, nothing computed twice, furniture that moves."""

import dataclasses
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from extras import need
from msgspec.structs import replace

need("tour")

from box_room import CUBE, BoxCapture, box_room, moved

from hyjax.configuration import Configuration
from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import UP, RoomCapture, load_room
from hyjax.data.frames import fit
from hyjax.data.light_file import write_lights
from hyjax.export.page_sun import sun_table
from hyjax.geometry.camera import Camera
from hyjax.geometry.shadow_caster import cast_shadow_maps
from hyjax.light.color import encoded
from hyjax.light.gbuffer import GBuffer
from hyjax.light.kinds import DirectionalLight, PointLight, SkyLight
from hyjax.metrics.psnr import psnr
from hyjax.pipeline import refine_visibility
from hyjax.scene.occluders import complete
from hyjax.scene.relighter import Relighter
from hyjax.scene.scene import Scene
from hyjax.tour import arrangement as arrangement_module
from hyjax.tour.arrangement import Arrangement
from hyjax.tour.layers import Caches, RenderCancelled, mebibytes
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import Piece, TourPlan, Window
from hyjax.tour.renderer import Renderer
from hyjax.tour.uncovered import uncovered_pixels
from hyjax.tour.viewpoint import Viewpoint

OWN = {
    "scale": 2,
    "sampling": 1,
    "bounces": False,
    "photo_exponent": 1.3,
    "map_scale": 0.5,
    "views": 4,
    "least_share": 0.05,
}
HYJAX, ALL_PIXELS = Schedule.preset("hyjax"), Schedule.preset("naive-50")
VIEW = Viewpoint(0, "relit", HYJAX)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Scene(BoxCapture(), box_room()))


@pytest.fixture
def plan() -> TourPlan:
    lamp = place_lamp("bulb", np.array([0.5, 0.4, 1.2]), UP)
    window = Window((1.98, 0.0, 1.3), (-1.0, 0.0, 0.0))
    return TourPlan(hour=9.0, windows=(window,), lamps=(lamp,)).check()


def seed_of(renderer: Renderer, plan: TourPlan) -> Piece:
    """The cube, as a click from above picks it."""
    hit = renderer.scene.pick(plan, (0.5, 0.4, 2.0), (0.0, 0.0, -1.0))
    assert hit is not None and hit.piece is None
    np.testing.assert_allclose(hit.point, (0.5, 0.4, 0.7), atol=1e-5)
    np.testing.assert_allclose(hit.normal, UP, atol=1e-6)
    return Piece(tuple(hit.origin.tolist()))


@pytest.mark.parametrize("name", ["all pixels", "default", "kept", "own"])
def test_a_picture_is_the_relighters(plan: TourPlan, tmp_path: Path, name: str) -> None:
    """Of an untouched plan, for the same lights and configuration."""
    scene = Scene(BoxCapture(), box_room())
    configuration = Configuration(schedule=ALL_PIXELS if name == "all pixels" else HYJAX)
    if name == "own":
        configuration = configuration.with_choices(OWN)
    kept = name == "kept"
    plan = plan if kept else replace(plan, existing={"ceiling": 0.4})
    renderer = Renderer(scene, keep_photo_light=kept, configuration=configuration)
    rendered = renderer.render(plan, Viewpoint(0, "relit", configuration.schedule))
    file = tmp_path / "lights.json"
    write_lights(file, renderer.lighting.setup(plan))
    if kept:
        configuration = configuration.with_choices({"photo_light": "kept"})
    relit = Relighter(scene, file, configuration).relit(0)
    assert not rendered.draft
    np.testing.assert_allclose(rendered.linear, relit.image, rtol=2e-4, atol=2e-5)
    filter_ = renderer.render(plan, Viewpoint(0, "refined filter", configuration.schedule)).picture / 255.0
    assert psnr(filter_, encoded(relit.relight_filter)) > 50.0


def test_a_large_frame_is_not_lit_smaller(
    renderer: Renderer, plan: TourPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the photo's light divided out."""
    expected = renderer.render(plan, VIEW).linear
    renderer.forget_frames()
    monkeypatch.setattr("hyjax.configuration.USUAL_PIXELS", 48 * 64 // 4)
    assert renderer.configuration.scale_of((48, 64)) == 2
    np.testing.assert_allclose(renderer.render(plan, VIEW).linear, expected, rtol=1e-5, atol=1e-6)


class GreyGuide:
    """Guide that is no frame."""

    name = fingerprint = "grey"

    def features(self, display: Any) -> Any:
        return display.mean(axis=-1, keepdims=True)


@pytest.mark.parametrize("name", ["default", "balanced", "fast"])
def test_drafts_and_schedules_of_all_pixels_take_turns(plan: TourPlan, name: str) -> None:
    """Whole or half, with a guide of its own: what is kept of one is not taken for another."""
    renderer = Renderer(Scene(BoxCapture(), box_room()), configuration=Configuration.preset(name))
    renderer.guide = GreyGuide()
    own = Viewpoint(0, "relit", renderer.configuration.schedule)
    whole = renderer.render(plan, own).linear
    fine = dataclasses.replace(own, schedule=ALL_PIXELS)
    for lumen, viewpoint in ((300.0, fine), (400.0, own)):
        lamps = tuple(replace(lamp, lumen=lumen, position=(0.2, 0.3, 1.0 + lumen / 1e3)) for lamp in plan.lamps)
        for draft in (True, False):
            shown = renderer.render(replace(plan, lamps=lamps), viewpoint, draft=draft)
            assert shown.linear.shape == whole.shape and np.isfinite(shown.linear).all()
    np.testing.assert_allclose(renderer.render(plan, own).linear, whole, atol=1e-5)


def test_an_arrangement_is_a_place(plan: TourPlan) -> None:
    """With a piece that was moved: without the tour's shader, a relighter makes the same picture of it."""
    renderer = Renderer(Scene(BoxCapture(), box_room()), keep_photo_light=True)
    piece = replace(seed_of(renderer, plan), pose=moved((0.0, -0.6, 0.0), 20.0))
    there, setup = replace(plan, pieces=(piece,)), renderer.lighting.setup(plan)
    place = Arrangement(renderer.scene, there, Caches(), None, renderer.configuration)
    relit = Relighter(place, setup, renderer.configuration).relit(renderer.frame(0))
    shown = photographed(place, renderer.camera(0))
    assert 0.5 < shown.mean() < 1.0
    made, expected = renderer.render(there, VIEW).linear, np.asarray(relit.image)
    np.testing.assert_allclose(made[shown], expected[shown], rtol=2e-4, atol=2e-5)


def photographed(place: Arrangement, camera: Camera) -> np.ndarray:
    """Pixels whose surface the photo shows where it is now."""
    return ~uncovered_pixels(place.gbuffer(camera), place.scanned(camera), place.caster)


def test_the_hour_changes_the_picture_and_a_lamp_lights_it(renderer: Renderer, plan: TourPlan) -> None:
    night = replace(plan, hour=1.0, lamps=())
    lit = replace(night, lamps=plan.lamps)
    day, dark, lamp = (renderer.render(p, VIEW).linear for p in (plan, night, lit))
    assert np.abs(day - dark).max() > 0.05 and np.abs(lamp - dark).max() > 0.05


def test_a_picture_tells_how_far_each_lamp_reaches(renderer: Renderer, plan: TourPlan) -> None:
    """One that lights the room, one that is off, a dim one, and one in the wardrobe, which nothing sees."""
    (lamp,) = plan.lamps
    lamps = lamp, replace(lamp, on=False), replace(lamp, lumen=0.1), replace(lamp, position=(-1.65, 1.5, 0.5))
    for stage in ("relit", "normals"):
        own, off, dim, hidden = renderer.render(replace(plan, lamps=lamps), replace_stage(VIEW, stage)).reach
        assert off is None and own is not None and dim is not None and hidden is not None
        assert own.share > 0.02 and own.visible > 0.3
        assert dim.share < 0.01 and hidden.share > 0.01 > hidden.visible


def replace_stage(viewpoint: Viewpoint, stage: Any) -> Viewpoint:
    return Viewpoint(viewpoint.frame, stage, viewpoint.schedule)


@pytest.fixture
def cast(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What shadow maps are cast of: a part of the room, and lights."""
    found: list[Any] = []

    def counted(caster: Any, lights: Any, *args: Any) -> Any:
        found.append((caster, lights))
        return cast_shadow_maps(caster, lights, *args)

    monkeypatch.setattr(arrangement_module, "cast_shadow_maps", counted)
    return found


def test_nothing_is_cast_twice(renderer: Renderer, plan: TourPlan, cast: list[Any]) -> None:
    renderer.forget_frames()
    renderer.render(plan, VIEW)
    cast.clear()
    dimmer = replace(plan.lamps[0], lumen=100.0, kelvin=5000.0)
    renderer.render(replace(plan, lamps=(dimmer,), weather="clear", exposure=1.0), VIEW)
    assert cast == [], "brightness, colour and exposure cast no shadow"
    elsewhere = replace(dimmer, position=(0.0, 0.0, 1.0))
    renderer.render(replace(plan, lamps=(elsewhere,)), VIEW)
    assert len(cast) == 1, "only of the lamp that moved"


def test_brightness_leaves_the_shadow_pass_and_a_place_does_not(
    renderer: Renderer, plan: TourPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kept visibility gives the picture of a renderer that has kept nothing."""
    passes: list[Any] = []
    real = arrangement_module.run_kept

    def counted(function: Any, *arrays: Any, **static: Any) -> Any:
        passes.extend([function] if function is refine_visibility else [])
        return real(function, *arrays, **static)

    monkeypatch.setattr(arrangement_module, "run_kept", counted)
    (lamp,) = plan.lamps
    changes = (
        (replace(lamp, lumen=100.0), 1),
        (replace(lamp, lumen=900.0, kelvin=5000.0), 0),
        (replace(lamp, lumen=0.0), 1),
        (replace(lamp, position=(0.0, 0.0, 1.0)), 1),
    )
    renderer.forget_frames()
    for changed, expected in changes:
        passes.clear()
        made = renderer.render(replace(plan, lamps=(changed,)), VIEW).linear
        assert len(passes) == expected
        fresh = Renderer(renderer.place, configuration=renderer.configuration)
        np.testing.assert_array_equal(fresh.render(replace(plan, lamps=(changed,)), VIEW).linear, made)


def test_candles_flicker_in_flight(renderer: Renderer, plan: TourPlan) -> None:
    candle = replace(place_lamp("candle", np.array([0.5, 0.4, 1.2]), UP), lumen=500.0)
    night, flight = replace(plan, hour=0.0, lamps=(candle,)), dataclasses.replace(VIEW, camera=renderer.camera(0))
    steady, bright, dim = (renderer.render(night, flight, seconds=s).linear.mean() for s in (0.0, 0.2, 0.4))
    assert len({float(steady), float(bright), float(dim)}) == 3 and np.ptp([steady, bright, dim]) < 0.5 * steady


def test_a_picture_can_be_cancelled_and_its_shadow_maps_are_kept(
    renderer: Renderer, plan: TourPlan, cast: list[Any]
) -> None:
    lamps = tuple(replace(plan.lamps[0], position=(0.1 * k, 0.2, 1.3)) for k in range(3))
    crowded = replace(plan, windows=(), lamps=lamps)
    with pytest.raises(RenderCancelled):
        renderer.render(crowded, VIEW, cancelled=lambda: len(cast) == 2)
    renderer.render(crowded, VIEW)
    assert len([light for _, lights in cast for light in lights if isinstance(light, PointLight)]) == 4, "one anew"


@pytest.mark.slow
def test_after_the_warm_up_nothing_is_compiled(plan: TourPlan) -> None:
    class Small(BoxCapture):
        def __getitem__(self, index: int) -> Any:
            return fit(super().__getitem__(index), (24, 32))

    compiled: list[str] = []

    def heard(event: str, _: float, **__: Any) -> None:
        if event == "/jax/core/compile/backend_compile_duration":
            compiled.append(event)

    renderer = Renderer(Scene(Small(), box_room()))
    jax.monitoring.register_event_duration_secs_listener(heard)
    try:
        dark = replace(plan, windows=(), lamps=())
        steps = list(renderer.warm_up(dark, VIEW))
        assert len(steps) > 5 and compiled
        compiled.clear()
        for lamps in ((), plan.lamps, 2 * plan.lamps):
            for draft in (True, False):
                renderer.render(replace(dark, lamps=lamps), VIEW, draft=draft)
        assert not compiled
    finally:
        jax.monitoring.unregister_event_duration_listener(heard)


def test_a_draft_is_coarse_where_something_moved_and_says_so(
    renderer: Renderer, plan: TourPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    fine = renderer.render(plan, VIEW)
    assert not renderer.render(plan, VIEW, draft=True).draft, "what is there already is taken"
    lamp = replace(plan.lamps[0], position=(0.3, 0.3, 1.4))
    sizes, shade = [], arrangement_module.shade_each

    def counted(seen: GBuffer, lights: Any) -> Any:
        sizes.append(seen.hit.shape)
        return shade(seen, lights)

    monkeypatch.setattr(arrangement_module, "shade_each", counted)
    draft = renderer.render(replace(plan, lamps=(lamp,)), VIEW, draft=True)
    fine = renderer.render(replace(plan, lamps=(lamp,)), VIEW)
    assert draft.draft and not fine.draft
    assert draft.picture.shape == fine.picture.shape
    assert np.abs(draft.linear - fine.linear).mean() < 0.02
    height, width = fine.frame.image.shape[:2]
    half, quarter = ((height // part, width // part) for part in (2, 4))
    assert sizes[0] == quarter and sizes[-1] == half and set(sizes) == {quarter, half}, (
        "a draft is relit at half the size of a whole picture"
    )


def test_a_draft_of_another_frame_is_small_and_one_of_another_brightness_is_not(
    renderer: Renderer, plan: TourPlan
) -> None:
    renderer.forget_frames()
    renderer.render(plan, VIEW)
    brighter = replace(plan, lamps=(replace(plan.lamps[0], lumen=2.0 * plan.lamps[0].lumen),))
    assert not renderer.render(brighter, VIEW, draft=True).draft
    other = dataclasses.replace(VIEW, frame=1)
    assert renderer.render(plan, other, draft=True).draft
    assert not renderer.render(plan, other).draft
    assert not renderer.render(plan, other, draft=True).draft, "it is there at full size now"


def test_what_is_kept_at_full_size_is_drafted_at_it(plan: TourPlan) -> None:
    """Where a lamp is too dim to cast a shadow, and where shadow maps are gone whose light is kept."""
    renderer = Renderer(
        Scene(BoxCapture(), box_room()), configuration=Configuration().with_choices({"least_share": 0.05})
    )
    plan = replace(plan, lamps=(*plan.lamps, replace(plan.lamps[0], lumen=1.0)))
    renderer.render(plan, VIEW)
    assert not renderer.render(plan, VIEW, draft=True).draft
    renderer._caches.maps = Caches().maps
    assert not renderer.render(plan, VIEW, draft=True).draft


def test_while_something_is_dragged_fine_detail_throws_no_shadows(plan: TourPlan, cast: list[Any]) -> None:
    scene = Scene(BoxCapture(), box_room(), detail=lambda: box_room().subdivide())
    renderer, faces = Renderer(scene, keep_photo_light=True), []
    for draft in (True, False):
        renderer.render(replace(plan, windows=()), VIEW, draft=draft)
        faces.append({len(caster.part.occluders.mesh.faces) for caster, (light,) in cast if not light.UNIFORM})
        cast.clear()
    closed = len(complete(box_room()).faces)
    assert faces == [{closed}, {closed + 4 * len(box_room().faces)}]


@pytest.mark.parametrize("shown", ["photo", "raw filter", "refined filter", "visibility", "conductances", "holes"])
def test_every_stage_can_be_shown(renderer: Renderer, plan: TourPlan, shown: Any) -> None:
    picture = renderer.render(replace(plan, exposure=-3.0), Viewpoint(1, shown, HYJAX)).picture
    assert picture.shape == (48, 64, 3) and picture.dtype == np.uint8
    assert len(np.unique(picture)) > (0 if shown in ("holes", "visibility") else 5)


def test_shadows_follow_a_piece_that_moves(renderer: Renderer, plan: TourPlan) -> None:
    """As if the moved mesh had been scanned so."""
    lamp = place_lamp("spot", np.array([1.0, 0.0, 2.4]), -UP)
    at_night = replace(plan, hour=1.0, windows=(), lamps=(lamp,))
    piece = seed_of(renderer, at_night)
    there = replace(at_night, pieces=(replace(piece, pose=moved((0.0, -1.0, 0.0), 20.0)),))
    found = renderer.render(there, VIEW).linear
    expected = Renderer(Scene(BoxCapture(), renderer.scene.apply_to_mesh(there))).render(at_night, VIEW).linear
    still = renderer.render(at_night, VIEW).linear
    place = Arrangement(renderer.scene, there, Caches(), None, renderer.configuration)
    shown = photographed(place, renderer.camera(0))
    assert np.abs(found - still)[shown].mean() > 5 * np.abs(found - expected)[shown].mean()


@pytest.mark.slow
def test_only_what_moved_is_cast_again(renderer: Renderer, plan: TourPlan, cast: list[Any]) -> None:
    piece, before = seed_of(renderer, plan), renderer.render(plan, VIEW).linear
    picked = replace(plan, pieces=(piece,))
    np.testing.assert_array_equal(renderer.render(picked, VIEW).linear, before)
    mesh = renderer.scene.piece_mesh(piece)
    assert mesh is not None
    list(renderer.lift(picked, VIEW))
    for draft, by in ((True, 0.1), (False, 0.1), (False, 0.2)):
        cast.clear()
        pushed = replace(piece, pose=moved((by, 0.0, 0.0)))
        renderer.render(replace(plan, pieces=(pushed,)), VIEW, draft=draft)
        faces = {len(caster.part.caster.mesh.faces) for caster, _ in cast}
        assert faces == {len(mesh.faces)} or (by == 0.1 and not draft), "of the room fine shadows are cast once"


def test_a_removed_piece_is_gone_and_put_back_all_is_as_before(renderer: Renderer, plan: TourPlan) -> None:
    piece = seed_of(renderer, plan)
    gone = replace(plan, pieces=(replace(piece, removed=True),))
    hit = renderer.scene.pick(gone, (0.5, 0.4, 2.0), (0.0, 0.0, -1.0))
    assert hit is None or hit.point[2] < 0.1
    put_back = replace(plan, pieces=(piece,))
    before, back = (renderer.render(p, VIEW).linear for p in (plan, put_back))
    assert np.abs(before - back).max() < 0.05 * before.max()


def test_a_ray_at_a_moved_piece_tells_where_it_was_scanned(renderer: Renderer, plan: TourPlan) -> None:
    piece = replace(seed_of(renderer, plan), pose=moved((0.0, -1.0, 0.0)))
    hit = renderer.scene.pick(replace(plan, pieces=(piece,)), (0.5, -0.6, 2.0), (0.0, 0.0, -1.0))
    assert hit is not None and hit.piece == 0
    np.testing.assert_allclose(hit.origin, (0.5, 0.4, 0.7), atol=1e-5)


def test_cached_results_are_weighed_in_mebibytes() -> None:
    arrays = [np.zeros((512, 512), np.float32), jnp.zeros((256, 1024), jnp.float32)]
    assert mebibytes(arrays) == 2.0
    frame = BoxCapture()[0]
    assert mebibytes(frame) == frame.image.nbytes / 2**20


@pytest.fixture(scope="module")
def room() -> RoomCapture:
    return load_room(n_frames=6, width=160, height=120, quality=0.25, progress=False)


def test_the_first_plan_has_the_rooms_windows(room: RoomCapture) -> None:
    renderer = Renderer(Scene(room, room.reference()), keep_photo_light=True)
    plan = renderer.first_plan()
    assert len(plan.windows) == sum(name.startswith("window") for name in room.anchors)
    assert plan.sky().direct > 1000
    lights = renderer.lighting.setup(plan).lights
    assert any(isinstance(light, DirectionalLight) for light in lights)


def test_the_first_plan_has_the_windows_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "windows.yaml"
    file.write_text("windows: [{center: [0, 2.5, 1.5], normal: [0, -1, 0], width: 1, height: 30}]")
    renderer = Renderer(Scene(BoxCapture(), box_room(), photo_sources=file))
    window = renderer.first_plan().windows[0]
    np.testing.assert_allclose(window.center, (0, 2.5, 1.5), atol=1e-5)
    assert (window.width, window.height) == (1, 20), "as large as a plan takes"


def test_a_place_without_walls_is_opened_under_the_open_sky() -> None:
    """Sky and sun all around, as named set-ups have them there; the sun's shadow follows the hour."""
    floor = trimesh.creation.box(bounds=[[-2, -2.5, -0.1], [2, 2.5, 0]])
    cube = trimesh.creation.box((0.7, 0.7, 0.7), trimesh.transformations.translation_matrix(CUBE))
    scene = Scene(BoxCapture(), trimesh.util.concatenate([floor, cube]))
    renderer = Renderer(scene, keep_photo_light=True)
    plan = renderer.first_plan()
    assert plan.open_sky and not plan.windows
    sky, sun, _ = renderer.lighting.setup(plan).lights
    assert isinstance(sky, SkyLight) and isinstance(sun, DirectionalLight) and sun.aperture is None
    assert float(sun.direction[2]) < -0.3
    assert 0 < float(sky.illuminance) < float(sun.illuminance)
    pictures = [renderer.render(replace(plan, hour=hour), VIEW).linear for hour in (9.0, 16.0)]
    assert np.abs(np.subtract(*pictures)).max() > 0.1
    low = renderer.lighting.setup(replace(plan, hour=19.95)).lights
    assert any(isinstance(light, DirectionalLight) for light in low), "until it sets"
    window = Window((1.98, 0.0, 1.3), (-1.0, 0.0, 0.0))
    assert len(renderer.lighting.setup(replace(plan, windows=(window,))).lights) == 3, "no window beside it"
    assert len(renderer.lighting.setup(replace(plan, open_sky=False)).lights) == 1
    table = sun_table(scene)
    assert table is not None
    assert {light["kind"] for row in table["rows"] for light in row["lights"]} == {"sky", "directional", "ambient"}
