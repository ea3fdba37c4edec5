"""Pictures of environments from above."""

from __future__ import annotations

from typing import Any

import numpy as np

from .. import _advsage
from ..errors import OptionError

#: Side of a picture, pixels.
SIDE = 480
#: It is drawn so many times as large, and made smaller, so that lines are smooth.
OVERSAMPLED = 2
#: Metres from the car to the upper edge; below it there is less.
AHEAD, BEHIND = 55.0, 25.0

BACKGROUND = (250, 250, 248)
ROUTE = (150, 200, 255)
LINES = {"lane": (228, 228, 224), "line": (205, 205, 198), "edge": (90, 90, 90)}
#: Fill of the ego, the adversary, other vehicles, and all else.
BOXES = [(34, 110, 214), (206, 44, 44), (150, 150, 150), (226, 160, 40)]

Points = np.ndarray[Any, np.dtype[np.float64]]


class Picture:
    """Draws an environment. The lines of a scene's map are kept until the scene changes."""

    def __init__(self) -> None:
        self._map: tuple[str, list[tuple[str, Points]]] | None = None

    def draw(self, environments: _advsage.Environments, number: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
        """Array (480, 480, 3)."""
        try:
            from PIL import Image, ImageDraw
        except ImportError as error:
            raise ImportError('pictures need Pillow: pip install "advsage[gym]"') from error
        shown = environments.picture(number)
        if shown is None:
            raise OptionError("there is nothing to render before the first reset")
        if self._map is None or self._map[0] != shown["scene"]:
            self._map = environments.picture_map(number)
        side = SIDE * OVERSAMPLED
        image = Image.new("RGB", (side, side), BACKGROUND)
        canvas = ImageDraw.Draw(image)
        place = _placed(shown["ego"], side)
        width = side / (AHEAD + BEHIND)
        assert self._map is not None
        for kind, points in self._map[1]:
            _line(canvas, place(points), LINES[kind], round(0.25 * width), side)
        _line(canvas, place(shown["route"]), ROUTE, round(1.0 * width), side)
        corners = place(shown["corners"].reshape(-1, 2)).reshape(-1, 4, 2)
        # The ego is on top.
        for kind, box in reversed(list(zip(shown["kinds"], corners, strict=True))):
            canvas.polygon([tuple(corner) for corner in box], fill=BOXES[kind])
            # A windscreen shows where the front is.
            screen = [tuple(0.75 * box[front] + 0.25 * box[rear]) for front, rear in [(0, 1), (3, 2)]]
            canvas.line(screen, fill=(255, 255, 255), width=2 * OVERSAMPLED)
        canvas.text((12, 10), f"{shown['time']:.1f} s", fill=(60, 60, 60), font_size=14 * OVERSAMPLED)
        return np.array(image.resize((SIDE, SIDE), Image.Resampling.BOX))


def _placed(ego: tuple[float, float, float], side: int) -> Any:
    """Maps points of the scene to the picture, in which the car heads up."""
    x, y, heading = ego
    scale = side / (AHEAD + BEHIND)
    forward = np.array([np.cos(heading), np.sin(heading)])
    right = np.array([np.sin(heading), -np.cos(heading)])

    def place(points: Points) -> Points:
        offset = points - np.array([x, y])
        return np.stack([side / 2 + scale * (offset @ right), scale * (AHEAD - offset @ forward)], axis=-1)

    return place


def _line(canvas: Any, points: Points, color: tuple[int, int, int], width: int, side: int) -> None:
    # A long line may cross the picture with all its points outside.
    if len(points) > 1 and (points.max(axis=0) > 0).all() and (points.min(axis=0) < side).all():
        canvas.line([tuple(point) for point in points], fill=color, width=width, joint="curve")
