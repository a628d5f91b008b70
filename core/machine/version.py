# SPDX-License-Identifier: GPL-3.0-or-later
"""Version of this package, and the libraries that its engine requires."""

VERSION = "0.1.0"

# Module to import: (name of the distribution, oldest supported version).
LIBRARIES = {
    "av": ("av", "14"),
    "cv2": ("opencv-python-headless", "4.10"),
    "embreex": ("embreex", "4.4"),
    "fast_simplification": ("fast-simplification", "0.2"),
    "jinja2": ("jinja2", "3.1"),
    "numba": ("numba", "0.61"),
    "numpy": ("numpy", "1.26"),
    "OpenEXR": ("OpenEXR", "3.3"),
    "PIL": ("pillow", "10"),
    "pillow_heif": ("pillow-heif", "1"),
    "plyfile": ("plyfile", "1"),
    "psutil": ("psutil", "6"),
    "pycolmap": ("pycolmap", "4.1"),
    "rawpy": ("rawpy", "0.24"),
    "scipy": ("scipy", "1.13"),
    "skimage": ("scikit-image", "0.24"),
    "torch": ("torch", "2.5"),
    "trimesh": ("trimesh", "4"),
    "xatlas": ("xatlas", "0.0.9"),
}
OUTDATED = "or newer is needed"  # by which callers recognise complaints about a version


def missing_libraries() -> list[str]:
    """List the libraries that this Python lacks to run the engine, a line each; none of them is imported."""
    from importlib import metadata, util

    found = []
    for module, (name, oldest) in LIBRARIES.items():
        if util.find_spec(module) is None:
            found.append(f"{name} is not installed")
            continue
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue  # installed without metadata: by the system's package manager, or built from source
        if numbers(version) < numbers(oldest):
            found.append(f"{name} is {version}, {oldest} {OUTDATED}")
    return found


def numbers(version: str) -> tuple[int, ...]:
    """Parse the leading numbers of a version: "2.13.0+cpu" gives (2, 13, 0)."""
    parts: list[int] = []
    for part in version.split("+")[0].split("."):
        if not part.isdigit():
            break
        parts.append(int(part))
    return tuple(parts)
