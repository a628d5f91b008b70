# SPDX-License-Identifier: GPL-3.0-or-later
"""IRGS++ among Blender's render engines: F12, and Rendered shading of 3D Views."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import bpy
import numpy as np

from ...core.errors import Cancelled, InputError, IrgsppError
from ...core.scene.camera import Camera
from ..importer.run_frame import Frame, albedo_scale, camera_of, chosen_run, frame_of, run_object, scene_camera
from ..windows import enlarged, redraw
from ..world.world_light import world_light
from .live_image import Follower, follow, follower_of, stop
from .preview import settings_of
from .session import Answer, Wish, session_of

ENGINE = "IRGSPP"
WHOLE = 1 << 14  # more pixels than any image has along a side
SCALE = 0.5  # of a large 3D View's pixels that are computed
LARGE = 700  # pixels along its longer side
# Panels for what the engine leaves out: stereo, freestyle, Grease Pencil, motion blur, simplification of scenes
EXCLUDED = {"RENDER_PT_stereoscopy", "RENDER_PT_freestyle", "RENDER_PT_gpencil", "RENDER_PT_simplify", "RENDER_PT_motion_blur"}


class IRGSPP_RenderEngine(bpy.types.RenderEngine):
    """Relights the reconstructed object by the World, as the engine sees it"""

    bl_idname = ENGINE
    bl_label = "IRGS++"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # Material Preview

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """F12: the image of one view layer."""
        try:
            self._render(depsgraph)
        except Cancelled:
            return  # Blender keeps what was shown so far
        except IrgsppError as error:
            self.report({"ERROR"}, str(error))

    def _render(self, depsgraph: bpy.types.Depsgraph) -> None:
        result = self.begin_result(0, 0, WHOLE, WHOLE, layer=depsgraph.view_layer.name)
        finished = False
        try:
            size = (result.resolution_x, result.resolution_y)
            self.update_stats("", "Starting")
            wish, run = final_wish(depsgraph, size)
            session = session_of(run)
            self.update_stats("", "Relighting" if session.ready else "Starting the engine")
            image = session.wait("final", wish, lambda answer: self._show(result, size, answer), self.test_break)
            _fill(result, size, image)
            finished = True
        finally:
            self.end_result(result, cancel=not finished)

    def _show(self, result: bpy.types.RenderResult, size: tuple[int, int], answer: Answer) -> None:
        self.update_progress(answer.share)
        self.update_stats("", f"Relighting {answer.share:.0%}")
        if answer.image is not None and not answer.done:
            _fill(result, size, answer.image)
            self.update_result(result)

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Something in the scene changed; the follower sees for itself."""
        viewport_of(context)

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw the latest image there is, and say what is wrong where there is none."""
        view = viewport_of(context)
        follower = follower_of(view.channel)
        if follower is not None and not follower.failed:
            view.draw(self, depsgraph.scene)
        self.update_stats("IRGS++", follower.message if follower is not None else "")


def final_wish(depsgraph: bpy.types.Depsgraph, size: tuple[int, int]) -> tuple[Wish, Any]:
    """What F12 wants of which run; size: of the border, where one is set. Raises InputError."""
    scene = depsgraph.scene.original
    run = chosen_run(scene, depsgraph.view_layer)
    thing = run_object(scene, run, depsgraph.view_layer)
    if thing is None:
        raise InputError(f"scene {scene.name}", "holds no object of the run", "import the run")
    frame = frame_of(thing.evaluated_get(depsgraph))
    camera = frame.camera(_cropped(scene_camera(scene, depsgraph, *_full_size(scene.render), frame), scene.render, size))
    how = settings_of(scene)
    use_world = how.pop("use_world")
    light = world_light(depsgraph.scene.world, scene.frame_current).turned(frame.rotation) if use_world else None
    backdrop = use_world and not scene.render.film_transparent
    return Wish(camera, light, albedo_scale=albedo_scale(thing), backdrop=backdrop, **how), run


def _full_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    share = render.resolution_percentage / 100
    return max(1, int(render.resolution_x * share)), max(1, int(render.resolution_y * share))


def _cropped(camera: Camera, render: bpy.types.RenderSettings, size: tuple[int, int]) -> Camera:
    """The part of a camera's image inside the border, which counts from the bottom left."""
    if size == (camera.width, camera.height):
        return camera
    left, top = int(render.border_min_x * camera.width), camera.height - int(render.border_min_y * camera.height) - size[1]
    return replace(camera, width=size[0], height=size[1], cx=camera.cx - left, cy=camera.cy - top)


def _fill(result: bpy.types.RenderResult, size: tuple[int, int], image: np.ndarray) -> None:
    """Put an image into the result; coarse ones are enlarged."""
    result.layers[0].passes["Combined"].rect.foreach_set(enlarged(image, *size))


# --- Rendered shading


@dataclass(eq=False)
class Viewport:
    """A 3D View in Rendered shading."""

    region: int
    channel: str
    matrices: tuple[Any, Any] = (None, None)  # camera to world, projection
    size: tuple[int, int] = (1, 1)
    image: np.ndarray | None = None
    texture: Any = None

    def see(self, context: bpy.types.Context) -> None:
        """Remember where it is seen from."""
        view, region = context.region_data, context.region
        self.matrices = view.view_matrix.inverted(), view.window_matrix.copy()
        self.size = max(1, region.width), max(1, region.height)

    def eye(self, scene: bpy.types.Scene, frame: Frame, width: int, height: int) -> Camera:
        """Its camera, for an image of so many pixels."""
        return camera_of(*self.matrices, *self.size, frame).resized(width, height)

    def pixels(self, scene: bpy.types.Scene) -> tuple[int, int]:
        """How many pixels are computed."""
        scale = SCALE if max(self.size) > LARGE else 1.0
        return max(1, round(self.size[0] * scale)), max(1, round(self.size[1] * scale))

    def show(self, image: np.ndarray, size: tuple[int, int], done: bool) -> None:
        """Take a new image; it is drawn at the next occasion."""
        self.image, self.texture = np.ascontiguousarray(np.clip(image[::-1], 0, 6e4), np.float32), None
        redraw("VIEW_3D")

    def wanted(self) -> bool:
        """False when the region is gone, in another shading or another engine's; then it is forgotten."""
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D" and any(region.as_pointer() == self.region for region in area.regions):
                    shown = area.spaces.active.shading.type == "RENDERED" and window.scene.render.engine == ENGINE
                    return shown or self._forget()
        return self._forget()

    def _forget(self) -> bool:
        _viewports.pop(self.region, None)
        return False

    def draw(self, engine: bpy.types.RenderEngine, scene: bpy.types.Scene) -> None:
        """Over the whole region, in linear colour, which Blender takes through the view transform."""
        if self.image is None:
            return
        import gpu  # pyright: ignore[reportMissingImports]
        from gpu_extras.presets import draw_texture_2d  # pyright: ignore[reportMissingImports]

        if self.texture is None:
            height, width = self.image.shape[:2]
            data = gpu.types.Buffer("FLOAT", width * height * 4, self.image.reshape(-1))
            self.texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=data)
        gpu.state.blend_set("ALPHA_PREMULT")
        engine.bind_display_space_shader(scene)
        draw_texture_2d(self.texture, (0, 0), *self.size)
        engine.unbind_display_space_shader()
        gpu.state.blend_set("NONE")


_viewports: dict[int, Viewport] = {}


def viewport_of(context: bpy.types.Context) -> Viewport:
    """The drawn region's viewport, with a follower that keeps it up to date as long as the region is in Rendered shading."""
    key = context.region.as_pointer()
    view = _viewports.setdefault(key, Viewport(key, f"view{key:x}"))
    view.see(context)
    follower = follower_of(view.channel)
    if follower is None or follower.stale:
        follow(Follower(view.channel, context.scene, None, view.eye, view.pixels, _viewport_settings, view.show, view.wanted))
    return view


def _viewport_settings(scene: bpy.types.Scene) -> dict[str, Any]:
    how = settings_of(scene)
    return {**how, "backdrop": how["use_world"] and not scene.render.film_transparent}


# --- registration


def compatible_panels() -> list[type]:
    """Blender's panels that make sense for this engine: those of every engine without EEVEE's, Cycles' or Workbench's own settings."""
    return [panel for panel in bpy.types.Panel.__subclasses__() if _fits(panel)]


def _fits(panel: type) -> bool:
    engines = getattr(panel, "COMPAT_ENGINES", None)
    return isinstance(engines, set) and "BLENDER_RENDER" in engines and panel.__name__ not in EXCLUDED


def register() -> None:
    """Show Blender's own panels to those who choose the engine."""
    for panel in compatible_panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    """Take the engine out of all panels, and let go of viewports."""
    for view in _viewports.values():
        stop(view.channel)
    _viewports.clear()
    for panel in bpy.types.Panel.__subclasses__():
        if isinstance(getattr(panel, "COMPAT_ENGINES", None), set):
            panel.COMPAT_ENGINES.discard(ENGINE)
