# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties that the scene's settings and the operators' keywords both have: their choices, and their names and tooltips."""

from typing import Any

UP_AXES = [
    ("AS_IS", "As It Is", "Keep the up direction that the engine estimated", 0),
    ("Y_UP", "+Y Up", "The dataset's Y axis becomes Blender's Z", 1),
    ("NEG_Y_UP", "-Y Up", "The dataset's Y axis points down, as in COLMAP", 2),
    ("X_UP", "+X Up", "The dataset's X axis becomes Blender's Z", 3),
    ("NEG_X_UP", "-X Up", "The dataset's X axis points down", 4),
    ("NEG_Z_UP", "-Z Up", "The dataset is upside down", 5),
    ("Z_UP", "+Z Up", "Keep the dataset's own axes", 6),
]
PRESETS = [
    ("draft", "Draft", "For a first impression: photographs reduced to 320 pixels, few steps; about a minute", 0),
    ("balanced", "Balanced", "For most objects: photographs reduced to 640 pixels; several minutes on a CPU", 1),
    ("high", "High", "For large photographs of fine detail: up to 1600 pixels, textures of 4096 or 8192; hours on a CPU", 3),
    ("paper", "Paper", "The published schedule: 50,000 steps, photographs of 800 pixels; hours, for a GPU", 2),
]
MATERIALS = [
    ("auto", "Find Out", "Try both material classes briefly and keep the one that reproduces held-back photographs better", 0),
    ("low-gloss", "Low Gloss", "Cloth, wood, plaster, plastic: the object reflects no clear images", 1),
    ("glossy", "Glossy", "Metal, glaze, lacquer: the object reflects its surroundings", 2),
]
DEVICES = [
    ("auto", "Best", "A graphics card if the engine can use one, otherwise the processor", 0),
    ("cpu", "CPU", "The processor", 1),
    ("cuda", "CUDA", "An NVIDIA graphics card", 2),
]
TURNTABLE = [
    ("auto", "Automatic", "Decided by whether a background with texture stays at its place"),
    ("on", "Yes", "The camera was fixed and the object turned before it"),
    ("off", "No", "The camera moved around the object"),
]
SOURCES = [
    ("textures", "Textures", "The material reads textures through the UV map", 0),
    ("attributes", "Attributes", "The material reads attributes at the mesh's vertices", 1),
]
BACKENDS = [
    ("mesh", "Mesh", "Trace shadows and reflections between parts of the object on its mesh: fast", 0),
    ("gaussian", "Gaussians", "Trace them through the fitted Gaussians: slower, but exactly as reconstructed", 1),
]
EYES = [
    ("camera", "Camera", "Look through the scene's camera", 0),
    ("view", "3D View", "Look from the same place as this 3D View", 1),
]
TEXTURE_PLACES = [
    ("auto", "Automatic", "Inside the file where its format can, otherwise beside it"),
    ("packed", "Inside", "Inside the file"),
    ("beside", "Beside", "In a folder beside the file, which is found when both are moved together"),
    ("tiles", "UDIM Tiles", "As UDIM tiles in a folder beside the file. Bake them first; not every program finds them by itself"),
]
TEXTURE_SIZES = [
    ("1024", "1k", "Textures of 1024 x 1024 texels"),
    ("2048", "2k", "Textures of 2048 x 2048 texels"),
    ("4096", "4k", "Textures of 4096 x 4096 texels"),
    ("8192", "8k", "Textures of 8192 x 8192 texels"),
]
BITS = [
    ("0", "As Before", "As in the last bake"),
    ("8", "8 Bits", "256 values, which every program reads"),
    ("16", "16 Bits", "65,536 values: no steps in smooth gradients, twice the memory"),
]
NORMAL_MAPS = [
    ("opengl", "OpenGL", "Green is up, as in Blender, Unity and Godot"),
    ("directx", "DirectX", "Green is down, as in Unreal Engine; .fbx and .obj only"),
]

COMPARISONS = [
    ("split", "Split", "The photograph on the left of a border, the result on the right", 0),
    ("fade", "Fade", "The photograph fades over the result", 1),
]

Definition = dict[str, Any]  # arguments of a function of `bpy.props`

PRESET: Definition = {
    "name": "Preset",
    "description": "Quality and duration of the reconstruction",
    "items": PRESETS,
    "default": "balanced",
}
MATERIAL: Definition = {"name": "Material", "description": "Material class of the object", "items": MATERIALS}
DEVICE: Definition = {"name": "Device", "description": "Hardware that computes the reconstruction", "items": DEVICES}
UP_AXIS: Definition = {"name": "Up", "description": "Axis of the dataset that becomes Blender's Z", "items": UP_AXES}
RECENTRE: Definition = {"name": "Recentre", "description": "Move the object's centre to Blender's origin"}
SOURCE: Definition = {"name": "Material Reads", "description": "Source of the values in the object's material", "items": SOURCES}
SHOW_CONFIDENCE: Definition = {
    "name": "Show Confidence",
    "description": "Glow in the confidence of albedo (red), roughness (green) and metallic (blue) instead of reflecting light: white is "
    "well known, dark is not. Seen in Material Preview and in rendered views",
}
TURNED: Definition = {"name": "Turntable", "description": "The object turns before a fixed camera", "items": TURNTABLE}

TEXTURE_SIZE: Definition = {
    "name": "Texture Size",
    "description": "Width and height of the textures. A size below that of the last bake is made from this bake at once, which is kept",
    "items": TEXTURE_SIZES,
    "default": "1024",
}
TEXTURE_BITS: Definition = {
    "name": "Bits",
    "description": "Bits of each value of albedo, roughness, metallic and normal textures. A .glb always has 8",
    "items": BITS,
    "default": "0",
}
UDIM: Definition = {
    "name": "UDIM Tiles",
    "description": "Tiles of this size along each side: 2 for 2 x 2, for more texels than one image holds; the UVs are packed again. "
    "1: one image; 0: as in the last bake, or by the edited mesh's UVs",
    "default": 0,
    "min": 0,
    "max": 4,
}
TRIANGLES: Definition = {
    "name": "Max Triangles",
    "description": "Make a new mesh of at most so many triangles; 0 keeps the mesh as it is",
    "default": 0,
    "min": 0,
}
QUADS: Definition = {
    "name": "Quads",
    "description": "Remesh the run's mesh to about so many quads, by QuadriFlow; 0 does not",
    "default": 0,
    "min": 0,
}
HEIGHT: Definition = {
    "name": "Height Texture",
    "description": "Also bake how far the surface as it was fused lies above a mesh of fewer triangles, for displacement",
    "default": False,
}
DISPLACE: Definition = {
    "name": "Displacement",
    "description": "Displace the mesh by its height texture in renders. Subdivide it first: a Subdivision Surface modifier set to Simple",
}
LODS: Definition = {
    "name": "Levels of Detail",
    "description": "Add versions with a half and a quarter of the triangles, which share the textures",
}
COLLISION: Definition = {
    "name": "Collision Hulls",
    "description": "Add a few convex solids that game engines take as the collision shape (UCX_...)",
}
ASSET_KIND: Definition = {
    "name": "Asset",
    "description": "Datablock that becomes the asset",
    "items": [
        ("COLLECTION", "Collection", "The object with levels of detail and collision hulls; placed as an instance or appended", 0),
        ("OBJECT", "Object", "The object alone", 1),
    ],
    "default": "COLLECTION",
}
OCCLUSION: Definition = {
    "name": "Occlusion",
    "description": "Trace how open each place of the surface is, for seconds: red of orm.png, and the occlusion texture of .glb",
}
AS_PLACED: Definition = {
    "name": "As in the Scene",
    "description": "Turn and scale the export as the object is turned and scaled in the scene; off: as it was reconstructed",
    "default": True,
}
TEXTURES: Definition = {"name": "Textures", "description": "Place of the textures", "items": TEXTURE_PLACES}
NORMAL_MAP: Definition = {
    "name": "Normal Map",
    "description": "Direction of green in the normal map of .fbx and .obj",
    "items": NORMAL_MAPS,
}

SAMPLES: Definition = {
    "name": "Samples",
    "description": "Light samples per pixel of the finished image: more samples, less noise",
    "default": 32,
    "min": 1,
    "max": 65536,
    "soft_max": 512,
}
DENOISE: Definition = {"name": "Denoise", "description": "Smooth the noise of few samples without blurring edges", "default": True}
BACKEND: Definition = {"name": "Trace", "description": "Geometry on which shadows and reflections are traced", "items": BACKENDS}
EYE: Definition = {"name": "Seen From", "description": "Point of view of the image", "items": EYES}
USE_WORLD: Definition = {
    "name": "Light from World",
    "description": "Light the object by this scene's World; otherwise by the recovered light",
    "default": True,
}
USE_LAMPS: Definition = {
    "name": "Lamps",
    "description": "Sun, point, spot and area lamps of the scene light the object as well",
    "default": True,
}
COMPARISON: Definition = {
    "name": "Comparison",
    "description": "How photograph and result are compared, seen through the photograph's camera",
    "items": COMPARISONS,
    "default": "split",
}
BORDER: Definition = {
    "name": "Border",
    "description": "Place of the border between photograph and result: 0 shows the result alone, 1 the photograph",
    "subtype": "FACTOR",
    "default": 0.0,
    "min": 0.0,
    "max": 1.0,
}
OPACITY: Definition = {
    "name": "Photograph over Object",
    "description": "Opacity of the photograph in front of the object, seen through its camera: 0 shows the object, 1 the photograph",
    "subtype": "FACTOR",
    "min": 0.0,
    "max": 1.0,
}
