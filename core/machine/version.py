# SPDX-License-Identifier: GPL-3.0-or-later
"""The version of this package, and the libraries that its engine needs."""

VERSION = "0.1.0"

# Module to import: (name of the distribution, oldest version that serves).
LIBRARIES = {
    "cv2": ("opencv-python-headless", "4.10"),
    "embreex": ("embreex", "4.4"),
    "fast_simplification": ("fast-simplification", "0.2"),
    "numba": ("numba", "0.61"),
    "numpy": ("numpy", "1.26"),
    "OpenEXR": ("OpenEXR", "3.3"),
    "PIL": ("pillow", "10"),
    "plyfile": ("plyfile", "1"),
    "psutil": ("psutil", "6"),
    "scipy": ("scipy", "1.13"),
    "skimage": ("scikit-image", "0.24"),
    "torch": ("torch", "2.5"),
    "trimesh": ("trimesh", "4"),
    "xatlas": ("xatlas", "0.0.9"),
}
NEWER = "or newer is needed"  # by which callers know complaints about a version


def problems() -> list[str]:
    """What this Python lacks to run the engine, a line each; imports nothing heavy."""
    from importlib import metadata, util

    found = []
    for module, (name, oldest) in LIBRARIES.items():
        if util.find_spec(module) is None:
            found.append(f"{name} is not installed")
            continue
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue  # put there by other means: a distribution's own package, a build of its own
        if numbers(version) < numbers(oldest):
            found.append(f"{name} is {version}, {oldest} {NEWER}")
    return found


def numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version: "2.13.0+cpu" is (2, 13, 0)."""
    parts: list[int] = []
    for part in version.split("+")[0].split("."):
        if not part.isdigit():
            break
        parts.append(int(part))
    return tuple(parts)
