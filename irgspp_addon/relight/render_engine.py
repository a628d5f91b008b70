# SPDX-License-Identifier: GPL-3.0-or-later
"""IRGS++ as a render engine of Blender: final renders (F12) and Rendered shading of 3D Views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...core.errors import Cancelled, IrgsppError
from ...core.scene.camera import Camera
from ..importer.run_frame import Frame, camera_of
from ..translations import translated
from ..windows import enlarged, redraw
from .final_request import final_request
from .left_out import left_out
from .live_image import Follower, follow, follower_of, stop
from .preview import settings_of
from .session import Answer, session_of

ENGINE = "IRGSPP"
WHOLE = 1 << 14  # upper limit of an image's width and height in pixels
SCALE = 0.5  # scale of the rendered image in large 3D Views, along each side
LARGE = 700  # longer side of a large 3D View in pixels
# Panels of features that the engine does not have: stereo, Freestyle, Grease Pencil, motion blur, simplification of scenes
EXCLUDED = {"RENDER_PT_stereoscopy", "RENDER_PT_freestyle", "RENDER_PT_gpencil", "RENDER_PT_simplify", "RENDER_PT_motion_blur"}
# A lamp's type alone, which is in EEVEE's panel, too; the node editor's panel has the same set of engines.
EXCLUDED |= {"DATA_PT_light", "NODE_DATA_PT_light"}
# Panels of EEVEE that apply as well: nodes of the World, material slots and nodes of the material, colour, power and size of a lamp
SHARED = {"EEVEE_WORLD_PT_surface", "EEVEE_MATERIAL_PT_context_material", "EEVEE_MATERIAL_PT_surface", "DATA_PT_EEVEE_light"}


class IRGSPP_RenderEngine(bpy.types.RenderEngine):
    """Render engine that relights the reconstructed object by the scene's World and lamps."""

    bl_idname = ENGINE
    bl_label = "IRGS++"
    bl_use_preview = False
    bl_use_eevee_viewport = True  # Material Preview
    is_known = False  # True once this instance has drawn: Blender makes a new one where the user chooses Rendered shading again

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Render the final image (F12) of one view layer."""
        try:
            self._render(depsgraph)
        except Cancelled:
            return  # Blender keeps the image shown so far
        except IrgsppError as error:
            self.report({"ERROR"}, str(error))

    def _render(self, depsgraph: bpy.types.Depsgraph) -> None:
        result = self.begin_result(0, 0, WHOLE, WHOLE, layer=depsgraph.view_layer.name)
        finished = False
        try:
            size = (result.resolution_x, result.resolution_y)
            self.update_stats("", "Starting")
            request, run = final_request(depsgraph, size)
            session = session_of(run)
            self.update_stats("", "Relighting" if session.ready else "Starting the engine")
            image = session.wait("final", request, lambda answer: self._show(result, size, answer), self.test_break)
            _fill(result, size, image)
            finished = True
            scene = depsgraph.scene.original
            if missing := left_out(scene, scene.view_layers[depsgraph.view_layer.name], run, final=True):
                text = translated("{missing}. IRGS++ draws one reconstruction under World and lamps.", missing=missing)
                self.report({"WARNING"}, text)
        finally:
            self.end_result(result, cancel=not finished)

    def _show(self, result: bpy.types.RenderResult, size: tuple[int, int], answer: Answer) -> None:
        self.update_progress(answer.fraction)
        self.update_stats("", translated("Relighting {percent}", percent=f"{answer.fraction:.0%}"))
        if answer.image is not None and not answer.done:
            _fill(result, size, answer.image)
            self.update_result(result)

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Register the 3D View when it or the scene has changed; its follower finds the changes itself.

        Args:
            context: context of the 3D View.
            depsgraph: evaluated dependency graph, unused.
        """
        viewport_of(context, again=not self.is_known)
        self.is_known = True

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw the latest image into a 3D View, and show progress or error as text.

        Args:
            context: context of the 3D View.
            depsgraph: evaluated dependency graph.
        """
        view = viewport_of(context)
        follower = follower_of(view.channel)
        if follower is not None and not follower.failed:
            view.draw(self, depsgraph.scene)
        missing = left_out(depsgraph.scene.original, context.view_layer, None)
        self.update_stats(f"IRGS++ | {missing}" if missing else "IRGS++", follower.message if follower is not None else "")


def _fill(result: bpy.types.RenderResult, size: tuple[int, int], image: np.ndarray) -> None:
    """Write an image (H, W, 4) into the render result, enlarged to `size` (width, height)."""
    result.layers[0].passes["Combined"].rect.foreach_set(enlarged(image, *size))


# --- Rendered shading


@dataclass(eq=False)
class Viewport:
    """3D View in Rendered shading.

    Attributes:
        region: address of its region, which identifies it.
        channel: name of its channel at the worker.
        matrices: matrices (4, 4) from the camera to Blender's world, and of the projection.
        size: width and height of the region in pixels.
        image: latest image (H, W, 4) float32, bottom row first, or None.
        texture: the image as a GPU texture, or None.
    """

    region: int
    channel: str
    matrices: tuple[Any, Any] = (None, None)
    size: tuple[int, int] = (1, 1)
    image: np.ndarray | None = None
    texture: Any = None

    def update(self, context: bpy.types.Context) -> None:
        """Store the current point of view and size."""
        view, region = context.region_data, context.region
        self.matrices = view.view_matrix.inverted(), view.window_matrix.copy()
        self.size = max(1, region.width), max(1, region.height)

    def camera(self, scene: bpy.types.Scene, frame: Frame, width: int, height: int) -> Camera:
        """Return the camera of the view, in Blender's world.

        Args:
            scene: scene, unused.
            frame: frame of the object.
            width: width of the image in pixels.
            height: height of the image in pixels.
        """
        return camera_of(*self.matrices, *self.size, frame).resized(width, height)

    def image_size(self, scene: bpy.types.Scene) -> tuple[int, int]:
        """Return the width and height of the rendered image in pixels; the scene is unused."""
        scale = SCALE if max(self.size) > LARGE else 1.0
        return max(1, round(self.size[0] * scale)), max(1, round(self.size[1] * scale))

    def show(self, image: np.ndarray, size: tuple[int, int], done: bool) -> None:
        """Store a new image and request a redraw.

        Args:
            image: (H, W, 4) linear premultiplied RGBA, top row first.
            size: width and height of the finished image in pixels, unused.
            done: True for the finished image, unused.
        """
        self.image, self.texture = np.ascontiguousarray(np.clip(image[::-1], 0, 6e4), np.float32), None
        redraw("VIEW_3D")

    def is_visible(self) -> bool:
        """Return False, and drop the viewport, if its region was closed or no longer has Rendered shading by this engine."""
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
        """Draw the image over the whole region, in linear colour, which Blender converts by the view transform.

        Args:
            engine: the render engine that draws.
            scene: scene with the colour management settings.
        """
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


def viewport_of(context: bpy.types.Context, again: bool = False) -> Viewport:
    """Return the viewport of the context's region, and start the follower that updates it while it has Rendered shading.

    Args:
        context: of the 3D View.
        again: also start one that has ended with an error.
    """
    key = context.region.as_pointer()
    view = _viewports.setdefault(key, Viewport(key, f"view{key:x}"))
    view.update(context)
    follower = follower_of(view.channel)
    if follower is None or follower.stale or (again and follower.ended):
        follow(Follower(view.channel, context.scene, None, view.camera, view.image_size, _viewport_settings, view.show, view.is_visible))
    return view


def _viewport_settings(scene: bpy.types.Scene) -> dict[str, Any]:
    settings = settings_of(scene)
    return {**settings, "backdrop": settings["use_world"] and not scene.render.film_transparent}


# --- registration


def compatible_panels() -> list[type]:
    """Return Blender's panels that apply to this engine: those common to all engines, and those of EEVEE in SHARED."""
    return [panel for panel in bpy.types.Panel.__subclasses__() if _is_compatible(panel)]


def _is_compatible(panel: type) -> bool:
    engines = getattr(panel, "COMPAT_ENGINES", None)
    if not isinstance(engines, set) or panel.__name__ in EXCLUDED:
        return False
    return "BLENDER_RENDER" in engines or panel.__name__ in SHARED


def register() -> None:
    """Show Blender's own panels when this engine is chosen."""
    for panel in compatible_panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    """Remove the engine from all panels and stop the followers of all viewports."""
    for view in _viewports.values():
        stop(view.channel)
    _viewports.clear()
    for panel in bpy.types.Panel.__subclasses__():
        if isinstance(getattr(panel, "COMPAT_ENGINES", None), set):
            panel.COMPAT_ENGINES.discard(ENGINE)
