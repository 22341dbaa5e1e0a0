"""Named materials in the light of a room: the looks of the page's viewer, for pictures.

The room is a smooth ambient and six lamps, each a spherical Gaussian L exp(k (d.u - 1)) whose
integral is what the lamp sheds (Wang et al. 2009); a rough surface blurs it to another one. Two
distant lamps go with the camera. Reflection is that of microfacets (Karis 2014); light that passes
through is bent where it leaves, as in glTF's KHR_materials_transmission and _volume; and what is
brighter than white is compressed as Khronos' neutral tone mapper does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from PIL import ImageColor

from morph_engine import srgb
from morph_engine.errors import unknown_name

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Material:
    """A material, in the terms of glTF.

    Attributes:
        color: Base colour as #rrggbb, of what has none of its own.
        roughness: 0 for a mirror, 1 for chalk.
        metalness: 1 for a metal.
        clearcoat: Share of a clear layer on top.
        clearcoat_roughness: Its roughness.
        sheen: Colour of the light that grazing sight sees, as #rrggbb.
        glow: Colour that shines by itself, for light that wanders inside, as #rrggbb.
        transmission: Share of the light that is not scattered inside, but passes through.
        ior: Index of refraction.
        thickness: Length of the path of light inside, over the radius of what is shown.
    """

    color: str
    roughness: float
    metalness: float = 0.0
    clearcoat: float = 0.0
    clearcoat_roughness: float = 0.1
    sheen: str = "#000000"
    glow: str = "#000000"
    transmission: float = 0.0
    ior: float = 1.5
    thickness: float = 0.0

    @property
    def reflectance(self) -> float:
        """What its surface reflects straight back, unless it is a metal."""
        return ((self.ior - 1) / (self.ior + 1)) ** 2


MATERIALS = {
    "clay": Material("#bd8163", 0.92),
    "porcelain": Material("#f2efe9", 0.3, clearcoat=0.3, clearcoat_roughness=0.06),
    "jelly": Material("#f0433a", 0.14, clearcoat=0.4, transmission=0.75, ior=1.38, thickness=0.35),
    "metal": Material("#c9ced6", 0.24, metalness=1.0),
    "wax": Material("#e9c687", 0.5, sheen="#ffb27a", glow="#2e1a0c"),
    "glass": Material("#f3fbfa", 0.03, transmission=1.0, ior=1.46, thickness=0.3),
}
"""All by name, those of the page."""

ROOM = 0.36
"""Strength of the room's light."""

AMBIENT = (0.9, 0.8)
"""Radiance of the room's walls at its horizon, and what is added straight above."""

DARKEST = 0.1
"""Radiance of its darkest place."""


def _unit(*towards: float) -> Floats:
    """A direction."""
    unit: Floats = np.array(towards) / np.linalg.norm(towards)
    return unit


ROOM_LAMPS = (
    (_unit(-16.1, 10.9, 8.2), 50.0, 0.0105),
    (_unit(-16.1, 14.5, -8.2), 50.0, 0.0090),
    (_unit(14.9, 8.7, -1.8), 17.0, 0.0780),
    (_unit(-0.5, 5.4, 14.5), 43.0, 0.0930),
    (_unit(3.2, 8.0, -12.5), 20.0, 0.0180),
    (_unit(0.0, 1.0, 0.0), 100.0, 0.0037),
)
"""Direction in the room (x to the right, y upwards), radiance, and solid angle [sr]."""

CAMERA_LAMPS = ((_unit(-0.7, 0.9, 0.5), 1.5), (_unit(0.8, 0.5, -1.2), 1.0))
"""Key and rim: direction as the eye sees it, and irradiance."""

EYE = np.array([0.0, 0.0, 1.0])
"""Towards the eye."""

DIELECTRIC = 0.04
"""What most surfaces that are no metal reflect straight back, a clear layer among them."""

LEAST_ROUGHNESS = 0.045
COMPRESSED_FROM = 0.76
DESATURATION = 0.15


def find(name: str) -> Material:
    """A material by its name.

    Raises:
        ConfigError: There is no such material.
    """
    if name not in MATERIALS:
        raise unknown_name("look", name, list(MATERIALS))
    return MATERIALS[name]


def bent(material: Material, normals: Floats) -> Floats:
    """Where light comes from that passes through, beside what is straight behind (Snell's law).

    Args:
        material: The material.
        normals: Unit normals as the eye sees them, z towards it, shape [n, 3].

    Returns:
        Offsets to the right and upwards over the radius of what is shown, shape [n, 2].
    """
    n = np.asarray(normals, np.float64)
    facing = np.clip(n[:, 2:], 0.0, 1.0)
    ratio = 1 / material.ior
    turned = ratio * facing - np.sqrt(1 - ratio**2 * (1 - facing**2))
    return np.asarray(material.thickness * turned * n[:, :2])


def light(
    material: Material,
    normals: Floats,
    openness: Floats,
    to_room: Floats,
    behind: Floats,
    colors: Floats | None = None,
) -> Floats:
    """The light that comes from some points of a material.

    Args:
        material: The material.
        normals: Unit normals as the eye sees them, z towards it, shape [n, 3].
        openness: What light of the room reaches a point, about 1, shape [n].
        to_room: Rotation from the eye to the room, whose y points upwards, shape [3, 3].
        behind: What is seen through each point: linear RGB, and how far that hides what is still
            farther away, shape [n, 4].
        colors: sRGB in place of the material's own, shape [n, 3], 0 to 1.

    Returns:
        Linear RGB, and how far each point hides what is behind all, shape [n, 4].
    """
    n = np.asarray(normals, np.float64)
    facing = np.clip(n[:, 2], 1e-3, 1.0)
    mirrored = 2 * facing[:, None] * n - EYE
    base = srgb.linear(_rgb(material.color) if colors is None else colors)
    reflected = material.reflectance + material.metalness * (base - material.reflectance)
    open_ = np.asarray(openness, np.float64)[:, None]
    matt = _diffuse(n, to_room) * open_
    grazing = (1 - facing[:, None]) ** 3
    inner = (1 - material.metalness) * base * matt
    if material.transmission:
        scale, bias = _fresnel(facing, material.roughness)
        entering = 1 - material.reflectance * scale - bias
        inner += material.transmission * (entering[:, None] * base * behind[:, :3] - inner)
    inner += grazing * srgb.linear(_rgb(material.sheen)) * matt
    inner += srgb.linear(_rgb(material.glow)) * open_
    outer = _glossy(n, mirrored, facing, material.roughness, reflected, to_room)
    outer = outer * np.minimum(open_, 1)
    if material.clearcoat:
        coat = _glossy(n, mirrored, facing, material.clearcoat_roughness, DIELECTRIC, to_room)
        outer = outer + material.clearcoat * coat
    hidden = 1 - material.transmission * (1 - behind[:, 3]) * base.mean(axis=-1)
    return np.column_stack([inner + outer, hidden])


def _diffuse(n: Floats, to_room: Floats) -> Floats:
    """Radiance of a white matt surface, shape [n, 1]."""
    within = n @ to_room.T
    horizon, above = AMBIENT
    room = horizon + above * 2 / 3 * within[:, 1]
    for towards, radiance, angle in ROOM_LAMPS:
        room = room + radiance * angle / np.pi * np.maximum(within @ towards, 0)
    total = ROOM * room
    for towards, irradiance in CAMERA_LAMPS:
        total = total + irradiance / np.pi * np.maximum(n @ towards, 0)
    return total[:, None]


def _glossy(
    n: Floats,
    mirrored: Floats,
    facing: Floats,
    roughness: float,
    reflected: Floats | float,
    to_room: Floats,
) -> Floats:
    """Radiance by reflection, shape [n, 3] or [n, 1]."""
    alpha = max(roughness, LEAST_ROUGHNESS) ** 2
    sharpness = 0.5 / alpha**2  # of the lobe around the mirrored sight
    within = mirrored @ to_room.T
    horizon, above = AMBIENT
    room = np.maximum(horizon + above * (1 - 0.5 * roughness) * within[:, 1], DARKEST)
    for towards, radiance, angle in ROOM_LAMPS:
        own = 2 * np.pi / angle
        wide = sharpness / (own + sharpness)  # how much the surface leaves of its peak
        room = room + radiance * wide * np.exp(own * wide * (within @ towards - 1))
    scale, bias = _fresnel(facing, roughness)
    total = (reflected * scale[:, None] + bias[:, None]) * (ROOM * room)[:, None]
    for towards, irradiance in CAMERA_LAMPS:
        half = _unit(*(towards + EYE))
        lobe = np.maximum(n @ half, 0)
        density = alpha**2 / (np.pi * (lobe**2 * (alpha**2 - 1) + 1) ** 2)
        cosine = np.maximum(n @ towards, 0)
        k = alpha / 2
        shadow = 1 / ((facing * (1 - k) + k) * (cosine * (1 - k) + k))
        rising = (1 - half[2]) ** 5
        strength = density * shadow / 4 * cosine * irradiance
        total = total + (reflected + (1 - reflected) * rising) * strength[:, None]
    return total


def _fresnel(facing: Floats, roughness: float) -> tuple[Floats, Floats]:
    """Factor and addend of the reflectance at normal incidence, of a surface in even light."""
    c0 = np.array([-1.0, -0.0275, -0.572, 0.022])
    c1 = np.array([1.0, 0.0425, 1.04, -0.04])
    a, b, c, d = roughness * c0 + c1
    grazing = np.minimum(a * a, np.exp2(-9.28 * facing)) * a + b
    return -1.04 * grazing + c, 1.04 * grazing + d


def _tone_mapped(light: Floats) -> Floats:
    """Light that a screen can show: less the haze of reflection, and compressed where bright."""
    least = light.min(axis=1, keepdims=True)
    offset = np.where(least < 2 * DIELECTRIC, least - 6.25 * least**2, DIELECTRIC)
    color = light - offset
    peak = color.max(axis=1, keepdims=True)
    left = 1 - COMPRESSED_FROM
    squeezed = 1 - left**2 / np.maximum(peak + left - COMPRESSED_FROM, left)
    bright = color * squeezed / np.maximum(peak, 1e-9)
    pale = 1 - 1 / (DESATURATION * (peak - squeezed) + 1)
    compressed = bright * (1 - pale) + squeezed * pale
    return np.where(peak < COMPRESSED_FROM, color, compressed)


def shown(light: Floats) -> Floats:
    """Light as a picture has it, sRGB, 0 to 1."""
    return srgb.encoded(_tone_mapped(light))


def _rgb(color: str) -> Floats:
    return np.array(ImageColor.getrgb(color)[:3]) / 255
