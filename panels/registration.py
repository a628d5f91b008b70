# SPDX-License-Identifier: GPL-3.0-or-later
"""Registration of all classes, menus and handlers with Blender.

This is the topmost module of the extension: it imports all packages, and no package imports it.
"""

from __future__ import annotations

from typing import Any

import bpy

from ..irgspp_addon import properties, translations
from ..irgspp_addon.comparison import photograph, split
from ..irgspp_addon.engine.process import run_engine
from ..irgspp_addon.importer import confidence_view, displacement, materials, moved_project
from ..irgspp_addon.jobs import queue as jobs
from ..irgspp_addon.jobs import timer as job_timer
from ..irgspp_addon.preferences_page import IRGSPP_Preferences
from ..irgspp_addon.relight import animation, render_engine
from ..irgspp_addon.relight import live_image as relight_follow
from ..irgspp_addon.relight import session as relight_session
from ..irgspp_addon.world import hdri_library
from ..operators import animation as animation_operators
from ..operators import asset_mark, import_dataset, light, live_shape, look_through, masks, rotate_light, shadow_catcher, true_size
from ..operators import capture as capture_operators
from ..operators import engine as engine_operators
from ..operators import jobs as job_operators
from ..operators import reconstruct as reconstruct_operators
from ..operators import relight as relight_operators
from ..operators import result as result_operators
from ..operators.import_run import IRGSPP_OT_import_run, draw_import
from ..operators.reconstruct import IRGSPP_OT_demo, IRGSPP_OT_reconstruct
from . import CLASSES as PANELS
from . import headline, images

CLASSES = (
    IRGSPP_Preferences,
    *properties.CLASSES,
    engine_operators.IRGSPP_OT_check_engine,
    engine_operators.IRGSPP_OT_install_engine,
    engine_operators.IRGSPP_OT_remove_engine,
    engine_operators.IRGSPP_OT_open_engine_folder,
    IRGSPP_OT_reconstruct,
    IRGSPP_OT_demo,
    job_operators.IRGSPP_OT_job_cancel,
    job_operators.IRGSPP_OT_job_finish,
    job_operators.IRGSPP_OT_job_resume,
    job_operators.IRGSPP_OT_job_forget,
    job_operators.IRGSPP_OT_job_log,
    IRGSPP_OT_import_run,
    *look_through.CLASSES,
    *light.CLASSES,
    *rotate_light.CLASSES,
    *shadow_catcher.CLASSES,
    *asset_mark.CLASSES,
    *import_dataset.CLASSES,
    *capture_operators.CLASSES,
    *true_size.CLASSES,
    *masks.CLASSES,
    *result_operators.CLASSES,
    *relight_operators.CLASSES,
    *animation_operators.CLASSES,
    render_engine.IRGSPP_RenderEngine,
    *PANELS,
)

_commands: list[Any] = []  # handles, needed to unregister them


def register() -> None:
    """Register translations, classes, menu entries, handlers and the command `blender --command irgspp`."""
    translations.register()
    for cls in CLASSES:
        if issubclass(cls, bpy.types.Operator) and cls.__doc__:
            cls.bl_description = cls.__doc__.removesuffix(".")  # the tooltip, to which Blender adds a full stop
        bpy.utils.register_class(cls)
    properties.register()
    hdri_library.register()
    materials.register()
    confidence_view.register()
    displacement.register()
    photograph.register()
    split.register()
    moved_project.register()
    jobs.CHANGED.append(properties.show_jobs)
    job_timer.register()
    live_shape.register()
    images.register()
    bpy.types.TOPBAR_MT_file_import.append(draw_import)
    bpy.types.STATUSBAR_HT_header.append(headline.draw_status)
    import_dataset.register()
    capture_operators.register()
    reconstruct_operators.register()
    result_operators.register()
    asset_mark.register()
    relight_session.register()
    relight_follow.register()
    render_engine.register()
    animation.register()
    _commands.append(bpy.utils.register_cli_command("irgspp", run_engine))


def unregister() -> None:
    """Unregister everything, in reverse order."""
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    animation.unregister()
    render_engine.unregister()
    relight_follow.unregister()
    relight_session.unregister()
    asset_mark.unregister()
    result_operators.unregister()
    reconstruct_operators.unregister()
    capture_operators.unregister()
    import_dataset.unregister()
    bpy.types.STATUSBAR_HT_header.remove(headline.draw_status)
    bpy.types.TOPBAR_MT_file_import.remove(draw_import)
    images.unregister()
    live_shape.unregister()
    job_timer.unregister()
    jobs.CHANGED.remove(properties.show_jobs)
    moved_project.unregister()
    split.unregister()
    photograph.unregister()
    displacement.unregister()
    confidence_view.unregister()
    materials.unregister()
    hdri_library.unregister()
    properties.unregister()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    translations.unregister()
