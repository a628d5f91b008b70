# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras as Metashape exports them: XML in the chunk's own frame, OpenCV's axes, tangential coefficients in Metashape's order."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from .lens import RealLens
from .source import Source, over, placed, save_png, similarity

BACKDROP = 0.5
WORLD = similarity((95.0, 30.0, -15.0), 2.0, (-1.0, 0.5, 3.0))


def write(source: Source, folder: Path) -> tuple[Path, np.ndarray]:
    """Write folder/NAME with cameras.xml, images and masks.

    Args:
        source: scene to write.
        folder: folder of the collection.

    Returns:
        The scene's folder, and the similarity (4, 4) from the scene's world to the dataset's frame.
    """
    scene, lens = folder / source.name, RealLens.of(source)
    document = ElementTree.Element("document", version="2.0.0")
    chunk = ElementTree.SubElement(document, "chunk", label="Chunk 1", enabled="true")
    _sensor(ElementTree.SubElement(chunk, "sensors", next_id="1"), lens, source.size)
    cameras = ElementTree.SubElement(chunk, "cameras", next_id="99")
    for number, shot in enumerate(source.interleaved()):
        label = f"IMG_{number:04d}"
        rgba = lens.image(source, shot.rgba)
        save_png(scene / "images" / f"{label}.png", over(rgba, BACKDROP))
        save_png(scene / "masks" / f"{label}.png", rgba[..., 3])
        camera = ElementTree.SubElement(cameras, "camera", id=str(number), sensor_id="0", label=label)
        matrix = placed(WORLD, shot.pose) @ np.diag([1.0, -1.0, -1.0, 1.0])
        ElementTree.SubElement(camera, "transform").text = " ".join(repr(float(v)) for v in matrix.reshape(-1))
    ElementTree.SubElement(cameras, "camera", id="98", sensor_id="0", label="IMG_not_aligned")
    transform = ElementTree.SubElement(chunk, "transform")
    for name, text in (("rotation", "1 0 0 0 1 0 0 0 1"), ("translation", "3912345.6 871234.5 4934567.8"), ("scale", "0.43")):
        ElementTree.SubElement(transform, name).text = text
    ElementTree.ElementTree(document).write(scene / "cameras.xml", encoding="UTF-8", xml_declaration=True)
    return scene, WORLD


def _sensor(sensors: ElementTree.Element, lens: RealLens, size: tuple[int, int]) -> None:
    """Add a sensor with a calibrated lens."""
    sensor = ElementTree.SubElement(sensors, "sensor", id="0", label="telephone", type="frame")
    resolution = {"width": str(size[0]), "height": str(size[1])}
    ElementTree.SubElement(sensor, "resolution", resolution)
    calibration = ElementTree.SubElement(sensor, "calibration", {"type": "frame", "class": "adjusted"})
    ElementTree.SubElement(calibration, "resolution", resolution)
    k1, k2, p1, p2, k3 = lens.distortion
    numbers = {"f": lens.focal, "cx": lens.cx - size[0] / 2, "cy": lens.cy - size[1] / 2, "k1": k1, "k2": k2, "k3": k3, "p1": p2, "p2": p1}
    for name, value in numbers.items():
        ElementTree.SubElement(calibration, name).text = repr(float(value))
