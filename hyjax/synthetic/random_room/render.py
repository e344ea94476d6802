"""Renderer of a random room: light on looks, highlights, mirror images, and antialiasing."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from hyjax.geometry.camera import Camera
from hyjax.geometry.raycast import Hits, RayCaster
from hyjax.synthetic.random_room import light as lights
from hyjax.synthetic.random_room.exposure import develop
from hyjax.synthetic.random_room.layout import RandomRoom
from hyjax.synthetic.random_room.light import Lighting, Points, dot
from hyjax.synthetic.surface import rows

EDGE_SAMPLES = 4
"""Number of further rays through a pixel with several surfaces."""
STEP = 2
"""Distance between samples of soft light in pixels."""


@dataclasses.dataclass(frozen=True)
class RenderedView:
    """Rendered view: a picture with its true depth and normals.

    Attributes:
        image: display-encoded, float32 in 8-bit steps.
        depth: metres along the camera's axis, 0 where there is nothing.
        normal: unit vectors in the camera's axes, towards the camera; 0 where there is nothing.
        light: irradiance / π.
    """

    image: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    normal: Float[np.ndarray, "h w 3"]
    light: Float[np.ndarray, "h w 3"]


def shoot(
    room: RandomRoom, caster: RayCaster, lighting: Lighting, camera: Camera, rng: np.random.Generator
) -> RenderedView:
    """Photograph a room."""
    h, w = camera.intrinsics.shape
    rays = camera.rays().reshape(-1, 3).astype(np.float32)
    hits = caster.cast(camera.origin, rays)
    points = _points(caster, camera.origin, rays, hits)
    pixel = 1.0 / camera.intrinsics.fx
    hit = hits.hit
    irradiance, shine = _light(room, caster, lighting, points, hits, rays, (h, w), camera, rng)
    color = _radiance(room, hits, rays, points, irradiance, pixel)
    sky = rng.uniform(0.6, 4.0) * np.mean([p.color for p in lighting.panels], axis=0)
    color[~hit] = _outside(rays[~hit], sky, rng)
    color += shine + _mirror(room, caster, lighting, hits, rays, points)
    picture = color.reshape(h, w, 3)
    edge = _shared(room, hits, points, (h, w))
    picture[edge] = _antialias(room, caster, camera, edge, picture, points, irradiance)
    normal = np.where(hit[:, None], points.normal @ camera.pose[:3, :3].astype(np.float32), 0)
    depth = np.where(hit, hits.distance, 0).astype(np.float32)
    normal, light = (x.reshape(h, w, 3).astype(np.float32) for x in (normal, irradiance))
    return RenderedView(develop(picture, rng), depth.reshape(h, w), normal, light)


def _points(caster: RayCaster, origin: np.ndarray, rays: np.ndarray, hits: Hits) -> Points:
    """End points of rays, with normals on the side of the ray."""
    distance = np.where(hits.hit, hits.distance, 20.0).astype(np.float32)
    position = origin.astype(np.float32) + rays * distance[:, None]
    face = caster.mesh.face_normals.astype(np.float32)[hits.face]
    normal = caster.interpolated_normals(hits).astype(np.float32)
    # The triangle decides which side is seen; at a rim a smooth normal may point away, and is laid level then.
    turned = (dot(face, normal) < 0) != (dot(face, rays) > 0)
    normal *= np.where(turned, np.float32(-1), np.float32(1))[:, None]
    away = dot(normal, rays) / dot(rays, rays)
    normal -= np.maximum(away, 0)[:, None] * rays
    normal /= np.maximum(np.sqrt(dot(normal, normal)), np.float32(1e-12))[:, None]
    normal[~hits.hit] = (0, 0, 1)
    return Points(position, normal, distance)


def _take(points: Points, index: Int[np.ndarray, "n"]) -> Points:
    return Points(rows(points.position, index), rows(points.normal, index), rows(points.depth, index))


def _light(
    room: RandomRoom,
    caster: RayCaster,
    lighting: Lighting,
    points: Points,
    hits: Hits,
    rays: np.ndarray,
    shape: tuple[int, int],
    camera: Camera,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Irradiance / π at every pixel, and the highlights of hard lamps."""
    h, w = shape
    every = np.arange(h * w).reshape(shape)[::STEP, ::STEP]
    coarse = _take(points, every.ravel())
    surface, looks = room.surface, room.looks
    soft = lights.soft_light(lighting, caster, looks, surface.material, coarse, every.shape, rng.random())
    for lamp in lighting.lamps:
        if lamp.radius > 0:
            soft += lights.hard_light(lamp, caster, coarse, rng)[0]
    total = _spread(lights.smooth(soft, coarse, every.shape), coarse, points, shape, every.shape)
    lamps = [lamp for lamp in lighting.lamps if lamp.radius == 0]
    if rng.random() < 0.15:
        lamps.append(lights.flash(camera.origin, rng))
    gloss, exponent = looks.gloss(rows(surface.material, hits.face))
    shiny = np.flatnonzero((gloss > 0) & hits.hit)
    highlight = np.zeros_like(points.position)
    view = -rays[shiny] / np.linalg.norm(rays[shiny], axis=1, keepdims=True)
    for lamp in lamps:
        direct, toward = lights.hard_light(lamp, caster, points, rng)
        total += direct
        half = view + toward[shiny]
        half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-6)
        n = exponent[shiny]
        lobe = np.maximum(dot(half, points.normal[shiny]), 0) ** n * (n + 2) / 8
        highlight[shiny] += 0.04 * (gloss[shiny] * lobe)[:, None] * direct[shiny]
    return total, highlight


def _spread(
    light: np.ndarray, coarse: Points, points: Points, shape: tuple[int, int], size: tuple[int, int]
) -> Float[np.ndarray, "n 3"]:
    """Upsample soft light from its samples to all pixels, never across borders (joint bilateral upsampling)."""
    i, j = np.indices(shape)
    total = np.zeros_like(points.position)
    weight = np.zeros(len(total), np.float32)
    for di in (0, 1):
        for dj in (0, 1):
            share = (np.abs(1 - di - (i % STEP) / STEP) * np.abs(1 - dj - (j % STEP) / STEP)).ravel()
            row, column = np.minimum(i // STEP + di, size[0] - 1), np.minimum(j // STEP + dj, size[1] - 1)
            near = (row * size[1] + column).ravel()
            use = share * (lights.alike(points, _take(coarse, near)) + 1e-3)
            total += use[:, None].astype(np.float32) * rows(light, near)
            weight += use.astype(np.float32)
    return total / weight[:, None]


def _radiance(
    room: RandomRoom,
    hits: Hits,
    rays: np.ndarray,
    points: Points,
    irradiance: np.ndarray,
    pixel: float,
) -> Float[np.ndarray, "n 3"]:
    """Radiance: albedo × light."""
    surface, looks = room.surface, room.looks
    face = hits.face
    cosine = np.abs(dot(points.normal, rays)) / np.sqrt(dot(rays, rays))
    width = (pixel * points.depth / np.sqrt(np.maximum(cosine, 0.02))).astype(np.float32)
    uv = np.einsum("nk,nkc->nc", hits.barycentric.astype(np.float32), rows(surface.uv, face))
    return looks.albedo(rows(surface.material, face), uv, 0.7 * width) * irradiance


def _outside(rays: np.ndarray, sky: np.ndarray, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Radiance outside: a bright sky over dark ground."""
    up = rays[:, 2] / np.linalg.norm(rays, axis=1)
    land = rng.uniform(0.05, 0.6) * rng.uniform(0.7, 1.0, 3) * sky
    edge = rng.uniform(-0.3, 0.2) + 0.05 * np.sin(9 * np.arctan2(rays[:, 1], rays[:, 0]) + rng.uniform(0, 6))
    return (land + (sky - land) * np.clip((up - edge) / 0.05, 0, 1)[:, None]).astype(np.float32)


def _mirror(
    room: RandomRoom, caster: RayCaster, lighting: Lighting, hits: Hits, rays: np.ndarray, points: Points
) -> Float[np.ndarray, "n 3"]:
    """Reflections in glossy things, in open light; blurred, as on most surfaces."""
    surface, looks = room.surface, room.looks
    gloss, _ = looks.gloss(rows(surface.material, hits.face))
    some = np.flatnonzero((gloss > 0.05) & hits.hit)
    out = np.zeros_like(points.position)
    if not some.size:
        return out
    way = rays[some] / np.linalg.norm(rays[some], axis=1, keepdims=True)
    normal = points.normal[some]
    cosine = np.clip(-dot(way, normal), 0, 1)
    way = way + 2 * cosine[:, None] * normal
    mirrored = caster.cast(points.position[some] + lights.OFFSET * normal, way)
    uv = np.einsum("nk,nkc->nc", mirrored.barycentric.astype(np.float32), rows(surface.uv, mirrored.face))
    far = np.minimum(np.where(mirrored.hit, mirrored.distance, 5), 5).astype(np.float32)
    albedo = looks.albedo(rows(surface.material, mirrored.face), uv, 0.01 + 0.02 * far)
    bright = np.mean([p.color for p in lighting.panels], axis=0).astype(np.float32)
    level = (lighting.above + 0.15 * bright).astype(np.float32)
    image = np.where(mirrored.hit[:, None], albedo * level, bright)
    fresnel = np.minimum((0.04 + 0.96 * (1 - cosine) ** 5) * gloss[some], 0.6)
    out[some] = image * fresnel[:, None]
    return out


def _shared(room: RandomRoom, hits: Hits, points: Points, shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    """Mask of pixels where looks, depth or normals change to a neighbour, which need antialiasing."""
    look = np.where(hits.hit, rows(room.surface.material, hits.face), -1).reshape(shape)
    depth, normal = points.depth.reshape(shape), points.normal.reshape(*shape, 3)
    edge = np.zeros(shape, dtype=bool)
    for axis in (0, 1):
        a, b = (slice(None, -1), slice(1, None)) if axis == 0 else (
            (slice(None), slice(None, -1)), (slice(None), slice(1, None)))  # fmt: skip
        change = (look[a] != look[b]) | (np.abs(depth[a] - depth[b]) > 0.02 * depth[a])
        change |= np.einsum("hwk,hwk->hw", normal[a], normal[b]) < 0.9
        edge[a] |= change
        edge[b] |= change
    return edge


def _antialias(
    room: RandomRoom,
    caster: RayCaster,
    camera: Camera,
    edge: np.ndarray,
    picture: np.ndarray,
    points: Points,
    irradiance: np.ndarray,
) -> Float[np.ndarray, "n 3"]:
    """Average further rays through the chosen pixels, each in the light of the most similar neighbour."""
    h, w = edge.shape
    i, j = np.nonzero(edge)
    k, turn = camera.intrinsics, camera.pose[:3, :3].astype(np.float32)
    # Very bright things are clipped before they are averaged, as on a sensor.
    top = 4 * np.percentile(picture, 80)
    total = np.minimum(picture[edge], top)
    for dx, dy in ((0.125, 0.625), (0.375, 0.125), (0.625, 0.875), (0.875, 0.375)):
        x, y = (j + dx - k.cx) / k.fx, (i + dy - k.cy) / k.fy
        rays = np.stack([x, y, np.ones_like(x)], -1).astype(np.float32) @ turn.T
        hits = caster.cast(camera.origin, rays)
        here = _points(caster, camera.origin, rays, hits)
        sx, sy = (1 if dx > 0.5 else -1), (1 if dy > 0.5 else -1)
        best = np.full(len(i), np.inf, np.float32)
        chosen = i * w + j
        for di, dj in ((0, 0), (0, sx), (sy, 0), (sy, sx), (0, -sx), (-sy, 0)):
            near = np.clip(i + di, 0, h - 1) * w + np.clip(j + dj, 0, w - 1)
            there = _take(points, near)
            off = np.abs(dot(here.normal, there.position - here.position)) / here.depth
            cost = off * 20 + 1 - dot(here.normal, there.normal)
            better = cost < best - 1e-4
            best[better], chosen[better] = cost[better], near[better]
        color = _radiance(room, hits, rays, here, rows(irradiance, chosen), 1 / k.fx)
        missed = ~hits.hit
        color[missed] = rows(picture.reshape(-1, 3), chosen[missed])
        total += np.minimum(color, top)
    return total / (1 + EDGE_SAMPLES)
