# SPDX-License-Identifier: GPL-3.0-or-later
"""German texts of the preferences."""

TEXTS: dict[str, str] = {
    "Existing": "Vorhanden",
    "Use a Python environment that already has the engine's libraries": (
        "Eine Python-Umgebung verwenden, die die Bibliotheken der Engine schon hat"
    ),
    "Managed": "Verwaltet",
    "Use an environment that this extension installs for itself": "Eine Umgebung verwenden, die diese Erweiterung für sich installiert",
    "In Blender": "In Blender",
    "Use the Python that runs Blender, if the libraries are installed there": (
        "Das Python verwenden, mit dem Blender läuft, wenn die Bibliotheken dort installiert sind"
    ),
    "Install the libraries for the processor": "Die Bibliotheken für den Prozessor installieren",
    "Also install the libraries for an NVIDIA graphics card; several gigabytes more": (
        "Auch die Bibliotheken für eine NVIDIA-Grafikkarte installieren; mehrere Gigabyte mehr"
    ),
    "Python environment that computes, separate from Blender because its libraries can conflict with Blender's": (
        "Python-Umgebung, die rechnet; getrennt von Blender, da ihre Bibliotheken sich mit denen von Blender nicht vertragen können"
    ),
    "Engine Python": "Python der Engine",
    "Python executable, or folder of a virtual environment, that has the engine's libraries (torch and others)": (
        "Python-Programm oder Ordner einer virtuellen Umgebung mit den Bibliotheken der Engine (torch und andere)"
    ),
    "Hardware that the engine computes on": "Hardware, auf der die Engine rechnet",
    "Folder of Python wheels (*.whl) to install from without the network. Empty: download them": (
        "Ordner mit Python-Wheels (*.whl) zum Installieren ohne Netz. Leer: herunterladen"
    ),
    "Package Index": "Paketverzeichnis",
    "Address of an additional package index for pip, such as the one with torch for CPU only. Empty: pip's default index": (
        "Adresse eines weiteren Paketverzeichnisses für pip, etwa das mit torch nur für die CPU. Leer: das übliche von pip"
    ),
    "HDRI Folder": "HDRI-Ordner",
    "Folder of images of surroundings (.hdr, .exr) that the panel Relight offers next to Blender's own": (
        "Ordner mit Bildern von Umgebungen (.hdr, .exr), die das Panel Neu beleuchten neben denen von Blender anbietet"
    ),
    "Jobs Survive Blender": "Aufträge überdauern Blender",
    "Jobs continue when Blender is closed. Otherwise they save their progress and stop, and can be resumed": (
        "Aufträge laufen weiter, wenn Blender geschlossen wird. Sonst speichern sie ihren Fortschritt, halten an und können "
        "fortgesetzt werden"
    ),
    "Install Again": "Neu installieren",
    "Waiting": "Wartet",
}
