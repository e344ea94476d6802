"""Relighting by each light of a set-up alone: light adds, so any mix is a weighted sum of these pictures."""

import dataclasses
import logging
from pathlib import Path
from typing import Any

from hyjax.light.kinds import LIGHT_KINDS, kind_name
from hyjax.relighting.run import relight_run
from hyjax.relighting.settings import RelightSettings
from hyjax.scene.scene import Scene
from hyjax.util.errors import InputError

_log = logging.getLogger(__name__)


def relight_each(settings: RelightSettings) -> dict[Path, dict[str, Any]]:
    """Relight by each light alone, with linear values, into a folder of its own.

    Ambient lights are left out where bounces stand in their place, which each picture has. Alone, no light is
    too weak to cast shadows: a sum is the picture that `least_share=0` has.

    Returns:
        The folders, with the content of their `run.json`.
    """
    settings = dataclasses.replace(settings, each_light=True, exr=True).check()
    scene = Scene.open(settings.scene, progress=not settings.quiet)
    setup = scene.lights(settings.lights, at_photo_sources=settings.divides_photo_light)
    if setup.existing:
        raise InputError("each_light: the photo's own light has no picture of its own; take 'existing' out")
    options = settings.open_configuration().light
    bounced = options.photo_light == "divided" and options.bounces
    lights = [light for light in setup.lights if not (bounced and light.UNIFORM)]
    if not lights:
        raise InputError("each_light: there are no lights but ambient ones")
    if len(lights) < len(setup.lights):
        _log.warning("each_light: ambient light is in no picture: it fills up bounces, which does not add")
    folders = [settings.out / f"{number}-{kind_name(light)}" for number, light in enumerate(lights)]
    found = sorted(path for kind in LIGHT_KINDS for path in settings.out.glob(f"*-{kind}") if path not in folders)
    if left := [path for path in found if path.name.partition("-")[0].isdecimal()]:
        raise InputError(f"out: {left[0]} is of an earlier run's light; remove it, or choose another --out")
    runs = dict[Path, dict[str, Any]]()
    for folder, light in zip(folders, lights, strict=True):
        alone = dataclasses.replace(setup, lights=(light,))
        runs[folder] = relight_run(dataclasses.replace(settings, out=folder), scene, alone)
    return runs
