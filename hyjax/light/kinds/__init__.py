"""Virtual lights and their illuminance on a surface, without shadows.

Units: positions and lengths in metres, angles in radians, `luminous_flux` in lumens (of the whole emitter),
`illuminance` in lux (lumens per square metre). `color` is linear RGB and multiplies them, so that a lamp of 800 lm
with colour (1, 1, 1) is white. All lights are pytrees whose every field is an array: anything may be optimised.

Every kind is a file here, and a line below. A kind from outside the package calls `register_light` itself; it then
shades, casts shadows, and is read from and written to lights files like these.
"""

from hyjax.light.kinds.ambient import AmbientLight as AmbientLight
from hyjax.light.kinds.aperture import Aperture as Aperture
from hyjax.light.kinds.base import LIGHT_KINDS as LIGHT_KINDS
from hyjax.light.kinds.base import Light as Light
from hyjax.light.kinds.base import kind_name as kind_name
from hyjax.light.kinds.base import pytree as pytree
from hyjax.light.kinds.base import register_light as register_light
from hyjax.light.kinds.directional import DirectionalLight as DirectionalLight
from hyjax.light.kinds.point import PointLight as PointLight
from hyjax.light.kinds.rect import RectLight as RectLight
from hyjax.light.kinds.sky import SkyLight as SkyLight
from hyjax.light.kinds.spot import SpotLight as SpotLight
