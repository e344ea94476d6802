"""Relighting by each light of a set-up alone: light adds, so any mix is a weighted sum of these pictures."""

import dataclasses
from pathlib import Path

from hyjax.light.kinds import kind_name
from hyjax.relighting.run import relight_capture
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.scene import Scene
from hyjax.util.errors import InputError


def relight_each(settings: RelightSettings) -> list[Path]:
    """Relight by each light alone, with linear values, into a folder of its own.

    Ambient lights are left out where bounces stand in their place, which each picture has.

    Args:
        settings: what to relight and how, all lights together.

    Returns:
        The folders.

    Raises:
        InputError: what `relight_capture` refuses, no lights but ambient ones, or light of the photos that is kept.
    """
    settings.check()
    scene = Scene.open(settings.scene, progress=not settings.quiet)
    setup = scene.lights(settings.lights, at_photo_sources=settings.divides_photo_light)
    if setup.existing:
        raise InputError("each_light: the photo's own light has no picture of its own; take 'existing' out")
    options = settings.open_configuration().light
    bounced = options.photo_light == "divided" and options.bounces
    lights = [light for light in setup.lights if not (bounced and light.UNIFORM)]
    if not lights:
        raise InputError("each_light: there are no lights but ambient ones")
    folders = [settings.out / f"{number}-{kind_name(light)}" for number, light in enumerate(lights)]
    for folder, light in zip(folders, lights, strict=True):
        alone = dataclasses.replace(setup, lights=(light,))
        relight_capture(dataclasses.replace(settings, exr=True, out=folder), scene=scene, lights=alone)
    return folders
