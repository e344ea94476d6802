"""Photo's own light and bounces in a tour: linear in each light, where the furniture is, kept by name."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from extras import need
from msgspec.structs import replace

need("tour")

from box_room import TOP, BoxCapture, box_room, moved
from reference.tour_plans import afternoon

from hyjax.core.schedule import Schedule
from hyjax.data.builtin_room import UP
from hyjax.geometry.camera import Camera, Intrinsics, look_at
from hyjax.geometry.raycast import RayCaster
from hyjax.light.kinds import AmbientLight
from hyjax.light.photo_light import on_pixels
from hyjax.light.setup import LightSetup
from hyjax.photo_light.estimate import Estimate, read_estimate
from hyjax.scene.exposure import exposed
from hyjax.scene.light_response import measured_response
from hyjax.scene.light_setups import EXPOSURES
from hyjax.scene.scene import Scene
from hyjax.scene.seen_surface import SeenSurface
from hyjax.tour import arrangement as arrangement_module
from hyjax.tour.arrangement import Arrangement
from hyjax.tour.furniture import merge_gbuffers
from hyjax.tour.kept_plan import KeptPlan
from hyjax.tour.lighting import lights_from_outside
from hyjax.tour.placement import place_lamp
from hyjax.tour.plan import Piece, TourPlan
from hyjax.tour.renderer import Renderer
from hyjax.tour.viewpoint import Viewpoint
from hyjax.util.cache import Arrays
from hyjax.util.errors import InputError

VIEW = Viewpoint(0, "relit", Schedule.preset("hyjax"))
LAMP = place_lamp("bulb", np.array([0.0, -1.0, 1.2]), UP)
NIGHT = TourPlan(hour=1.0, lamps=(LAMP,))
CUBE = Piece(tuple(TOP.tolist()))


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    """Renderer of a room whose photo light is believed, though its pictures are noise: else nothing bounces."""

    def believed(caster: RayCaster, arrays: Arrays) -> Estimate:
        return read_estimate(caster, {**arrays, "exponent": np.array(1.0)})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hyjax.scene.photo_light.read_estimate", believed)
        return Renderer(Scene(BoxCapture(), box_room()))


def test_faces_of_parts_count_the_scans_triangles(renderer: Renderer) -> None:
    """At a hit, the scan's triangle is where the piece was scanned."""
    pose = moved((0.3, -0.9, 0.2), 40.0)
    parts = renderer.scene.apply(replace(NIGHT, pieces=(replace(CUBE, pose=pose),)))
    camera = Camera(Intrinsics(80, 60, 50.0, 50.0, 40.0, 30.0), look_at(np.array([-1.5, -2.2, 1.6]), TOP, UP))
    mesh = renderer.scene.mesh
    for part in parts.parts:
        gbuffer = part.gbuffer(camera)
        hit, face = np.asarray(gbuffer.hit), np.asarray(gbuffer.face)
        assert hit.any() and ((face >= 0) == hit).all()
        corners = mesh.vertices[mesh.faces[face[hit]]]
        scanned = np.einsum("nk,nkc->nc", np.asarray(gbuffer.barycentric)[hit], corners)
        there = scanned @ part.pose[:3, :3].T + part.pose[:3, 3]
        np.testing.assert_allclose(there, np.asarray(gbuffer.position)[hit], atol=1e-3)
        numbers = part.scanned_vertices
        assert numbers is not None
        np.testing.assert_allclose(mesh.vertices[numbers], part.caster.mesh.vertices)


def test_what_was_brought_in_gets_mean_bounces(renderer: Renderer, tmp_path: Path) -> None:
    box_room().export(tmp_path / "mesh.ply")
    own = Renderer(Scene(BoxCapture(), box_room()), folder=tmp_path)
    brought = replace(NIGHT, pieces=(Piece((0.0, 0.0, 0.0), pose=moved((0.0, 0.0, 0.3)), file="mesh.ply"),))
    parts = own.scene.apply(brought)
    camera = own.camera(0)
    gbuffer = merge_gbuffers([part.gbuffer(camera) for part in parts.parts])
    assert gbuffer.face is not None
    foreign = np.asarray(gbuffer.hit & (gbuffer.face < 0))
    assert foreign.any() and not foreign.all()
    values = jnp.asarray(np.random.default_rng(0).uniform(size=(len(box_room().vertices), 3)), jnp.float32)
    pixels = np.asarray(on_pixels(values, jnp.asarray(box_room().faces, jnp.int32), gbuffer))
    np.testing.assert_allclose(pixels[foreign], np.broadcast_to(values.mean(axis=0), (foreign.sum(), 3)), rtol=1e-5)
    assert np.isfinite(own.render(brought, VIEW).linear).all()


def test_bounces_are_computed_once_a_light(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def counted(*args: object, **options: object) -> object:
        calls.append(args)
        return bounced(*args, **options)  # type: ignore[arg-type]

    bounced = arrangement_module.bounced_by
    monkeypatch.setattr(arrangement_module, "bounced_by", counted)
    elsewhere = replace(LAMP, position=(0.1, -1.1, 1.0))
    renderer.render(replace(NIGHT, lamps=(elsewhere,)), VIEW)
    assert len(calls) == 1
    renderer.render(replace(NIGHT, lamps=(replace(elsewhere, lumen=300.0, kelvin=5000.0),), exposure=1.0), VIEW)
    renderer.render(replace(NIGHT, lamps=(elsewhere,)), replace_frame(VIEW, 1))
    assert len(calls) == 1, "brightness, colour and another frame need none"


def replace_frame(viewpoint: Viewpoint, frame: int) -> Viewpoint:
    return Viewpoint(frame, viewpoint.shown, viewpoint.schedule)


def bounces(renderer: Renderer, plan: TourPlan) -> np.ndarray:
    """Bounces of the lamps of a plan, which no ambient light fills up."""
    setup = renderer.lighting.setup(plan)
    lamps = [light for light in setup.lights if not light.UNIFORM]
    place = Arrangement(renderer.scene, plan, renderer._caches, renderer.photo_light, renderer.configuration)
    return np.asarray(place.surface_light(lamps).bounced)


def test_two_lamps_bounce_as_much_as_both(renderer: Renderer) -> None:
    """Linear: the light of a set-up is the sum over its lamps."""
    other = replace(LAMP, position=(-0.8, 0.5, 1.6), lumen=300.0, kelvin=6000.0)

    def bounced(*lamps: object) -> np.ndarray:
        return bounces(renderer, replace(NIGHT, lamps=lamps))

    both = bounced(LAMP, other)
    assert both.min() > 0
    np.testing.assert_allclose(both, bounced(LAMP) + bounced(other), rtol=1e-4, atol=2e-3)


def test_bounces_follow_furniture_that_moves(renderer: Renderer) -> None:
    """A table under the lamp catches its light, and loses it when it is pushed away."""
    away = replace(NIGHT, pieces=(replace(CUBE, pose=moved((-1.5, 0.9, 0.0))),))
    still, pushed = bounces(renderer, NIGHT), bounces(renderer, away)
    assert np.abs(pushed - still).max() > 0.01 * still.mean()


def test_the_photos_light_can_be_kept_source_by_source(renderer: Renderer) -> None:
    """With all of it left and nothing else, there is the photo."""
    light = renderer.photo_light
    assert light is not None
    dark = TourPlan(hour=1.0)
    photo = renderer.frame(0).image
    rendered = renderer.render(replace(dark, existing=dict.fromkeys(light.estimate.names, 1.0)), VIEW)
    assert np.abs(rendered.picture / 255.0 - photo).mean() < 0.03
    half = renderer.render(replace(dark, existing=dict.fromkeys(light.estimate.names, 0.5)), VIEW)
    np.testing.assert_allclose(half.linear, 0.5 * rendered.linear, atol=0.05)


def test_unknown_sources_are_refused_with_a_hint(renderer: Renderer) -> None:
    with pytest.raises(InputError, match="did you mean 'ceiling'"):
        renderer.render(replace(NIGHT, existing={"celing": 1.0}), VIEW)
    light = renderer.photo_light
    assert light is not None and light.unknown({"ceiling": 1.0}) is None
    assert "did you mean 'ceiling'" in (light.unknown({"celing": 1.0}) or "")


def test_sources_of_another_room_are_left_out_with_one_notice(tmp_path: Path) -> None:
    (tmp_path / "tour.json").write_text(
        replace(NIGHT, existing={"celing": 0.5, "walls": 0.3, "attic": 1.0}).to_json()
    )
    kept = KeptPlan(Renderer(Scene(BoxCapture(), box_room())), tmp_path)
    assert kept.plan.existing == {"walls": 0.3}
    (notice,) = kept.notices
    assert "another room" in notice and "'celing' (did you mean 'ceiling'?), 'attic'" in notice
    kept.keep(replace(kept.plan, existing={"ceiling": 0.5}))
    kept.save()
    assert TourPlan.from_json((tmp_path / "tour.json").read_text()).existing == {"ceiling": 0.5}


def test_moved_furniture_leaves_the_photo_light_as_it_was(renderer: Renderer) -> None:
    """What a frame was lit by depends on the frame alone, not on furniture that has moved since."""
    before = renderer.render(NIGHT, VIEW)
    renderer.render(replace(NIGHT, pieces=(replace(CUBE, pose=moved((0.0, -0.6, 0.0))),)), VIEW)
    np.testing.assert_array_equal(renderer.render(NIGHT, VIEW).linear, before.linear)


@pytest.mark.parametrize("hour", [9.0, 14.0, 16.0])
def test_light_that_is_kept_one_by_one_is_exposed_as_all_of_it_at_once(renderer: Renderer, hour: float) -> None:
    plan = afternoon(hour=hour)
    lights, _ = lights_from_outside(plan, UP)
    every = (*lights, AmbientLight(np.float32(1.0), np.ones(3, np.float32)))
    assert renderer.photo_light is not None
    cameras = [renderer.captured_camera(index) for index in range(len(renderer.capture))]
    seen, _ = SeenSurface.of(renderer.scene.caster, cameras)
    response = measured_response(every, seen, renderer.photo_light.estimate.light)
    setup = exposed(LightSetup(every), seen.lux(every), seen, EXPOSURES["noon-window"], response)
    outside = renderer.lighting.outside(plan)
    assert outside.lux == pytest.approx(setup.reference_lux, rel=1e-5)
    for kept, light in zip(outside.lights, setup.lights[:-1], strict=True):
        assert getattr(kept, kept.STRENGTH) == pytest.approx(getattr(light, light.STRENGTH), rel=1e-5)
