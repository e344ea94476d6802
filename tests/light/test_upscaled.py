"""Frames that are relit at a part of their size: the filter is brought to full size, the frame's texture stays."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from hyjax.core.schedule import Schedule
from hyjax.core.upsampling import guided_upsample
from hyjax.light.color import to_display, to_linear
from hyjax.light.emission import Emission
from hyjax.light.upscaled import upscaled_picture, upscaled_stages
from hyjax.pipeline import relight
from hyjax.util.errors import InputError

SIZE, FACTOR = (48, 64), 2
