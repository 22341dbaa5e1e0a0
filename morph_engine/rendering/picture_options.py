"""How pictures and videos of a result are drawn: size, path of the eye, background, look."""

from __future__ import annotations

from dataclasses import dataclass

from PIL import ImageColor

from morph_engine.errors import ConfigError, unknown_name
from morph_engine.rendering import materials
from morph_engine.rendering.camera_path import CameraPath
from morph_engine.rendering.video_encoder import TRANSPARENT_KINDS

STILL = CameraPath()


@dataclass(frozen=True)
class PictureOptions:
    """How pictures and videos are drawn.

    Attributes:
        size: Width and height [pixels], even numbers from 16 to 4096.
        camera: The path of the eye.
        background: A colour as typed, see `background_color`.
        material: A name of `materials.MATERIALS`, for what has no colours of its own and for how
            all shines, with a soft shadow on the ground; plain matter under one lamp when not
            given.
    """

    size: tuple[int, int] = (960, 720)
    camera: CameraPath = STILL
    background: str = "white"
    material: str | None = None

    def check(self, kind: str) -> None:
        """Refuse what cannot be drawn, or not be in a video of that kind.

        Raises:
            ConfigError: The size, the background or the material is none that can be used.
        """
        width, height = self.size
        if min(self.size) < 16 or max(self.size) > 4096 or width % 2 or height % 2:
            raise ConfigError(
                f"A video cannot have {width} x {height} pixels.",
                "Use even numbers from 16 to 4096, such as 960x720.",
            )
        if background_color(self.background) is None and kind not in TRANSPARENT_KINDS:
            raise ConfigError(
                f"A video of kind {kind} cannot have a transparent background.",
                f"Use a colour, or one of the kinds {', '.join(TRANSPARENT_KINDS)}.",
            )
        if self.material:
            materials.find(self.material)


def background_color(text: str) -> tuple[float, float, float] | None:
    """A background as typed: RGB, 0 to 1, or None for a transparent one.

    Args:
        text: ``transparent``, a name such as ``white``, or ``#rrggbb``.

    Raises:
        ConfigError: It is no colour.
    """
    if text == "transparent":
        return None
    try:
        red, green, blue = ImageColor.getrgb(text)[:3]
    except ValueError as error:
        if text.isalpha():
            names = ["transparent", *ImageColor.colormap]
            raise unknown_name("colour", text, names, list_known=False) from error
        raise ConfigError(
            f"{text!r} is not a colour.",
            "Use transparent, a name such as black, or a code such as #1e2a38.",
        ) from error
    return red / 255, green / 255, blue / 255
