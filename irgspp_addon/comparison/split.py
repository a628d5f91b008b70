# SPDX-License-Identifier: GPL-3.0-or-later
"""Photograph left of a border and the scene right of it, drawn over the image of the camera in 3D Views.

The handler is called at each drawing of a 3D View and looks up everything anew, so that undo, other files and removed cameras
leave nothing behind.
"""

from __future__ import annotations

from typing import Any

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d

from ..translations import translated
from .photograph import border, shown_photograph

Rectangle = tuple[float, float, float, float]  # left, bottom, right, top in pixels of a region

LINE = 2.0  # width of the border, pixels
TEXT, MARGIN = 12, 8  # size of the words and their distance from the border, pixels at a display scale of 1
VERTEX = "void main() { uv = coordinate; gl_Position = ModelViewProjectionMatrix * vec4(position, 0.0, 1.0); }"
FRAGMENT = "void main() { colour = texture(photograph, uv); }"

_handler: Any = None
_shader: Any = None


def camera_rectangle(scene: bpy.types.Scene, region: Any, view: Any) -> Rectangle | None:
    """Return the frame of the scene's camera in a 3D View's region; None where it can't be projected.

    Args:
        scene: with its camera.
        region: with width and height in pixels.
        view: `RegionView3D` that looks through the camera.
    """
    camera = scene.camera
    pose = camera.matrix_world.normalized()
    corners = [location_3d_to_region_2d(region, view, pose @ corner) for corner in camera.data.view_frame(scene=scene)]
    if any(corner is None for corner in corners):
        return None
    across, up = [corner.x for corner in corners], [corner.y for corner in corners]
    return min(across), min(up), max(across), max(up)


def draw() -> None:
    """Draw photograph, border and words where the 3D View of the context looks through a photograph's camera."""
    context = bpy.context
    scene, view, space = context.scene, context.region_data, context.space_data
    place, shown = border(scene), shown_photograph(scene)
    if (
        shown is None
        or not place
        or view is None
        or view.view_perspective != "CAMERA"
        or (space.use_local_camera and space.camera != scene.camera)
    ):
        return
    image, frame = shown.image, camera_rectangle(scene, context.region, view)
    if frame is None or not all(image.size):  # its file is gone
        return
    left, bottom, right, top = frame
    middle = left + place * (right - left)
    _draw_photograph(image, (left, bottom, middle, top), place, background_colour(context))
    _draw_rectangle((middle - LINE / 2, bottom, middle + LINE / 2, top), (1.0, 1.0, 1.0, 0.9))
    _draw_words(context, frame, middle)


def background_colour(context: bpy.types.Context) -> tuple[float, float, float, float]:
    """Return the theme's colour behind the scene, shown where a photograph is transparent."""
    colour = context.preferences.themes[0].view_3d.space.gradients.high_gradient
    return (*colour[:3], 1.0)


def _draw_photograph(image: bpy.types.Image, part: Rectangle, fraction: float, behind: tuple[float, float, float, float]) -> None:
    """Draw the left part of a photograph in its own colours, without the scene's view transform.

    Args:
        image: the photograph.
        part: rectangle to fill.
        fraction: of the photograph's width that it shows.
        behind: colour where the photograph is transparent.
    """
    import gpu  # pyright: ignore[reportMissingImports]
    from gpu_extras.batch import batch_for_shader  # pyright: ignore[reportMissingImports]

    _draw_rectangle(part, behind)
    shader = _photograph_shader()
    corners = {"position": _corners(part), "coordinate": _corners((0.0, 0.0, fraction, 1.0))}
    gpu.state.blend_set("ALPHA")
    shader.bind()
    shader.uniform_sampler("photograph", gpu.texture.from_image(image))
    batch_for_shader(shader, "TRIS", corners, indices=((0, 1, 2), (2, 3, 0))).draw(shader)
    gpu.state.blend_set("NONE")


def _photograph_shader() -> Any:
    """Return the shader that writes linear colours, which the framebuffer encodes; built-in ones expect sRGB before Blender 5.0."""
    global _shader
    if _shader is None:
        import gpu  # pyright: ignore[reportMissingImports]

        between, info = gpu.types.GPUStageInterfaceInfo("irgspp_photograph"), gpu.types.GPUShaderCreateInfo()
        between.smooth("VEC2", "uv")
        info.push_constant("MAT4", "ModelViewProjectionMatrix")
        info.sampler(0, "FLOAT_2D", "photograph")
        info.vertex_in(0, "VEC2", "position")
        info.vertex_in(1, "VEC2", "coordinate")
        info.vertex_out(between)
        info.fragment_out(0, "VEC4", "colour")
        info.vertex_source(VERTEX)
        info.fragment_source(FRAGMENT)
        _shader = gpu.shader.create_from_info(info)
    return _shader


def _draw_rectangle(rectangle: Rectangle, colour: tuple[float, float, float, float]) -> None:
    """Fill a rectangle of the region with a colour, sRGB and alpha."""
    import gpu  # pyright: ignore[reportMissingImports]
    from gpu_extras.batch import batch_for_shader  # pyright: ignore[reportMissingImports]

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    shader.uniform_float("color", colour)
    batch_for_shader(shader, "TRIS", {"pos": _corners(rectangle)}, indices=((0, 1, 2), (2, 3, 0))).draw(shader)
    gpu.state.blend_set("NONE")


def _draw_words(context: bpy.types.Context, frame: Rectangle, middle: float) -> None:
    """Write on both sides of the border what is seen there, where there is space for it.

    Args:
        context: of the 3D View.
        frame: of the camera.
        middle: place of the border.
    """
    import blf  # pyright: ignore[reportMissingImports]

    scale, (left, bottom, right, top) = context.preferences.system.ui_scale, frame
    margin = MARGIN * scale
    blf.size(0, TEXT * scale)
    height = max(bottom, 0.0) + margin
    for text, begin, side in ((translated("Photograph"), left, -1), (translated("Result"), right, 1)):
        width = blf.dimensions(0, text)[0]
        if abs(begin - middle) < width + 2 * margin or top - bottom < 3 * margin:
            continue
        x = middle + margin if side > 0 else middle - margin - width
        _draw_rectangle((x - margin / 2, height - margin / 2, x + width + margin / 2, height + margin * 1.5), (0.0, 0.0, 0.0, 0.5))
        blf.color(0, 1.0, 1.0, 1.0, 1.0)
        blf.position(0, x, height, 0.0)
        blf.draw(0, text)


def _corners(rectangle: Rectangle) -> tuple[tuple[float, float], ...]:
    left, bottom, right, top = rectangle
    return ((left, bottom), (right, bottom), (right, top), (left, top))


def register() -> None:
    """Add the handler, which draws only with a window."""
    global _handler
    if not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", "POST_PIXEL")


def unregister() -> None:
    """Remove the handler and the shader."""
    global _handler, _shader
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
    _handler = _shader = None
