# SPDX-License-Identifier: GPL-3.0-or-later
"""German texts of the operators: names, tooltips, keywords and reports."""

TEXTS: dict[str, str] = {
    # Animation
    "Render the scene's frames, or one turn of the light, by IRGS++ to numbered files, while Blender stays usable": (
        "Die Frames der Szene oder eine Drehung des Lichts mit IRGS++ in nummerierte Dateien rendern; Blender bleibt benutzbar"
    ),
    "Stop rendering the animation. Its finished frames stay": "Das Rendern der Animation anhalten. Die fertigen Frames bleiben",
    "Render Animation": "Animation rendern",
    "Output": "Ausgabe",
    "Path of the files; their number and suffix are added. Empty: the scene's Output Path": (
        "Pfad der Dateien; Nummer und Endung werden angehängt. Leer: der Ausgabepfad der Szene"
    ),
    "Turn the Light": "Licht drehen",
    "World and lamps turn once about the object while everything else stays; otherwise the scene's animation is rendered": (
        "Welt und Lampen drehen sich einmal um das Objekt, alles andere bleibt; sonst wird die Animation der Szene gerendert"
    ),
    "Frames": "Frames",
    "Frames of a turn of the light; 0: as many as the scene has": "Frames einer Drehung des Lichts; 0: so viele, wie die Szene hat",
    "No animation is rendered": "Es wird keine Animation gerendert",
    # Asset
    "Mark the object, or its collection, as an asset of the Asset Browser with preview image, author, licence, tags and catalogue": (
        "Das Objekt oder seine Sammlung als Asset des Asset-Browsers markieren, mit Vorschaubild, Autor, Lizenz, Stichwörtern und Katalog"
    ),
    "Hulls of {name}": "Hüllen von {name}",
    "Author": "Autor",
    "Who made the object": "Wer das Objekt gemacht hat",
    "Licence": "Lizenz",
    "Licence under which the object may be used, such as CC-BY 4.0": "Lizenz, unter der das Objekt verwendet werden darf, etwa CC-BY 4.0",
    "Description": "Beschreibung",
    "What the object is": "Was das Objekt ist",
    "Tags": "Stichwörter",
    "Words to search by, separated by commas": "Wörter zum Suchen, durch Kommas getrennt",
    "Catalogue": "Katalog",
    "Path of its catalogue in the asset library, such as Reconstructions/Toys. Empty: none": (
        "Pfad des Katalogs in der Asset-Bibliothek, etwa Rekonstruktionen/Spielzeug. Leer: keiner"
    ),
    "Image file for the preview. Empty: the relit object": "Bilddatei für die Vorschau. Leer: das neu beleuchtete Objekt",
    "{names}: not packed, and their files are missing: others will not find them": (
        "{names}: nicht gepackt, und die Dateien fehlen: andere finden sie nicht"
    ),
    "The preview is Blender's own: {error}": "Die Vorschau ist die von Blender: {error}",
    # Capture
    "Find the cameras of photographs or of a video, cut the object out, and import cameras, points and the object's sphere": (
        "Die Kameras von Fotos oder eines Videos suchen, das Objekt ausschneiden und Kameras, Punkte und die Kugel des Objekts importieren"
    ),
    "Choose a video of the object in place of a folder of photographs": "Ein Video des Objekts statt eines Ordners mit Fotos auswählen",
    "Choose Video": "Video auswählen",
    "Folder of photographs, a video, a dataset with cameras and without masks, or a capture that was stopped": (
        "Ordner mit Fotos, ein Video, ein Datensatz mit Kameras und ohne Masken oder eine angehaltene Aufnahme"
    ),
    "Captured Dataset": "Datensatz der Aufnahme",
    "Folder for cameras, undistorted photographs and masks. Empty: next to the photographs, with their name and _capture": (
        "Ordner für Kameras, entzerrte Fotos und Masken. Leer: neben den Fotos, mit ihrem Namen und _capture"
    ),
    "Marker": "Marker",
    "Side of the black square of a printed marker, in metres; 0: no marker": (
        "Seite des schwarzen Quadrats eines gedruckten Markers in Metern; 0: kein Marker"
    ),
    "Seed of all random numbers": "Startwert aller Zufallszahlen",
    "Single settings, as capture.key=value separated by spaces": "Einzelne Einstellungen als capture.key=value, durch Leerzeichen getrennt",
    "Find cameras of {name}": "Kameras suchen: {name}",
    "Cut out the object of {name}": "Objekt ausschneiden: {name}",
    "no cameras were found": "es wurden keine Kameras gefunden",
    "cameras of {count} photographs found": "Kameras von {count} Fotos gefunden",
    "; and {count} more": "; und {count} weitere",
    "Video": "Video",
    "Video around the object": "Video um das Objekt herum",
    # Engine
    "Start the engine and show its version and the devices it can compute on": (
        "Die Engine starten und ihre Version und die Geräte zeigen, auf denen sie rechnen kann"
    ),
    "Install the engine's libraries into a folder of this extension: about 1 GB for the CPU, several GB for CUDA": (
        "Die Bibliotheken der Engine in einen Ordner dieser Erweiterung installieren: etwa 1 GB für die CPU, mehrere GB für CUDA"
    ),
    "Delete the engine that this extension has installed": "Die Engine löschen, die diese Erweiterung installiert hat",
    "Open the folder of the installed engine": "Den Ordner der installierten Engine öffnen",
    "Install Engine": "Engine installieren",
    "Remove": "Entfernen",
    "For": "Für",
    "Hardware that the engine will compute on": "Hardware, auf der die Engine rechnen wird",
    "Wheels": "Wheels",
    "Folder of Python wheels to install from without the network. Empty: download them": (
        "Ordner mit Python-Wheels zum Installieren ohne Netz. Leer: herunterladen"
    ),
    "Install engine": "Engine installieren",
    "This extension has not installed an engine": "Diese Erweiterung hat keine Engine installiert",
    "Checking the engine": "Die Engine wird geprüft",
    "Jobs are running or waiting": "Aufträge laufen oder warten",
    # Import
    "Show what the engine reads of the photographs and their cameras, and any problems with them": (
        "Zeigen, was die Engine von den Fotos und ihren Kameras liest, und welche Probleme es gibt"
    ),
    "Import the cameras, photographs and points of a dataset; they replace its last import": (
        "Kameras, Fotos und Punkte eines Datensatzes importieren; sie ersetzen seinen letzten Import"
    ),
    "Import a dropped file: a dataset (transforms.json, a COLMAP model's cameras.bin) or a finished run (run.json)": (
        "Eine abgelegte Datei importieren: einen Datensatz (transforms.json, cameras.bin eines COLMAP-Modells) oder einen "
        "fertigen Lauf (run.json)"
    ),
    "Inspect Dataset": "Datensatz untersuchen",
    "Import IRGS++ Dataset": "IRGS++-Datensatz importieren",
    "Import into IRGS++": "In IRGS++ importieren",
    "IRGS++ dataset or run": "IRGS++-Datensatz oder -Lauf",
    "Dataset": "Datensatz",
    "Folder of photographs with known cameras": "Ordner mit Fotos, deren Kameras bekannt sind",
    "The engine has just read the dataset for this import": "Die Engine hat den Datensatz gerade für diesen Import gelesen",
    "File": "Datei",
    "IRGS++ Dataset (folder of photographs with known cameras)": "IRGS++-Datensatz (Ordner mit Fotos und bekannten Kameras)",
    "Inspect {name}": "Untersuchen: {name}",
    "Import {name}": "Importieren: {name}",
    "Import the object, material, light and cameras of a finished reconstruction; they replace its last import": (
        "Objekt, Material, Licht und Kameras einer fertigen Rekonstruktion importieren; sie ersetzen ihren letzten Import"
    ),
    "Import IRGS++ Run": "IRGS++-Lauf importieren",
    "Pack Textures": "Texturen packen",
    "As Photographed": "Wie fotografiert",
    "Light the scene with the recovered light and look through the first camera, without tone mapping": (
        "Die Szene mit dem gefundenen Licht beleuchten und durch die erste Kamera blicken, ohne Tone-Mapping"
    ),
    "Arrange View": "Ansicht einrichten",
    (
        "At the first import: frame the object in Material Preview, hide the cameras and the untouched default cube and "
        "light, and replace the untouched default World by the recovered light"
    ): (
        "Beim ersten Import: das Objekt in der Materialvorschau einrahmen, Kameras und den unveränderten Würfel samt Licht "
        "verbergen und die unveränderte Welt durch das gefundene Licht ersetzen"
    ),
    "IRGS++ Run (folder)": "IRGS++-Lauf (Ordner)",
    # Jobs
    "Stop the job and save its progress, so that it can be resumed. Press again to end it at once": (
        "Den Auftrag anhalten und seinen Fortschritt speichern, damit er fortgesetzt werden kann. Nochmals drücken beendet ihn sofort"
    ),
    "Stop optimising and continue with the present result, to the mesh and its materials": (
        "Die Optimierung beenden und mit dem jetzigen Ergebnis weitermachen, bis zum Mesh und seinen Materialien"
    ),
    "Continue a reconstruction that was stopped or has failed, from its last checkpoint": (
        "Eine angehaltene oder fehlgeschlagene Rekonstruktion vom letzten Zwischenstand an fortsetzen"
    ),
    "Remove a finished job from the list; its results stay in their folder": (
        "Einen fertigen Auftrag aus der Liste entfernen; seine Ergebnisse bleiben in ihrem Ordner"
    ),
    "Open the log with everything that the job printed": "Das Protokoll mit allem öffnen, was der Auftrag ausgegeben hat",
    "Id of the job in the list of jobs": "Kennung des Auftrags in der Liste",
    "Forget": "Vergessen",
    "stopping; the progress is being saved": "hält an; der Fortschritt wird gespeichert",
    "continuing with the next phase": "macht mit der nächsten Phase weiter",
    "Wait": "Warten",
    "Wait until it is finished, as scripts do; otherwise queue it as a job": (
        "Warten, bis es fertig ist, wie Skripte es tun; sonst als Auftrag einreihen"
    ),
    "Folder of a reconstruction. Empty: that of the active object, or of the panel": (
        "Ordner einer Rekonstruktion. Leer: der des aktiven Objekts oder des Panels"
    ),
    "Import the result into the scene when it is finished": "Das Ergebnis in die Szene importieren, wenn es fertig ist",
    # Light
    "Light the scene by an image of the surroundings, as its World. Rotation and strength stay as they are": (
        "Die Szene mit einem Bild der Umgebung als Welt beleuchten. Drehung und Stärke bleiben, wie sie sind"
    ),
    "Light the scene as the object was photographed, by the recovered light as its World": (
        "Die Szene beleuchten, wie das Objekt fotografiert wurde: mit dem gefundenen Licht als Welt"
    ),
    "Lat-long image (.hdr or .exr)": "Bild in Längen- und Breitengraden (.hdr oder .exr)",
    ("Rotate the World about the vertical axis: move the mouse left and right, click to confirm, Esc to restore, Shift for precision"): (
        "Die Welt um die senkrechte Achse drehen: Maus nach links und rechts bewegen, Klick bestätigt, Esc stellt wieder "
        "her, Umschalt für Genauigkeit"
    ),
    "Rotate Light": "Licht drehen",
    "Angle": "Winkel",
    "Rotation to add": "Drehung, die dazukommt",
    "Rotation {angle}°   click: confirm, Esc: restore, Shift: precise": (
        "Drehung {angle}°   Klick: bestätigen, Esc: wiederherstellen, Umschalt: genau"
    ),
    "The World has no Mapping node to rotate; open an HDRI": "Die Welt hat keine Mapping-Node zum Drehen; ein HDRI öffnen",
    # Cameras
    "Make this the scene camera, set the render resolution to its photograph's, and look through it: scene and photograph align": (
        "Diese Kamera zur Szenenkamera machen, die Renderauflösung ihres Fotos setzen und durch sie blicken: Szene und Foto decken sich"
    ),
    "Look through the camera of the next or previous photograph": "Durch die Kamera des nächsten oder vorigen Fotos blicken",
    "Show or hide the imported cameras and the sphere around the object in the 3D View": (
        "Die importierten Kameras und die Kugel um das Objekt in der 3D-Ansicht zeigen oder verbergen"
    ),
    "Look Through Camera": "Durch Kamera blicken",
    "Next Photograph": "Nächstes Foto",
    "Name of an imported camera. Empty: the active object": "Name einer importierten Kamera. Leer: das aktive Objekt",
    "Step": "Schritt",
    "Photographs to go on by; negative: back": "Fotos, um die weitergegangen wird; negativ: zurück",
    "The scene has no imported cameras": "Die Szene hat keine importierten Kameras",
    "Show": "Zeigen",
    "Show the cameras; otherwise hide them": "Die Kameras zeigen; sonst verbergen",
    # Masks
    "Paint the mask of this camera's photograph in an Image Editor: erase what is not the object, add what is missing": (
        "Die Maske des Fotos dieser Kamera in einem Bildeditor malen: radieren, was nicht zum Objekt gehört, hinzufügen, was fehlt"
    ),
    'Paint on the mask with the brush "IRGS++ Mask"': 'Mit dem Pinsel "IRGS++ Mask" auf der Maske malen',
    "Write the masks that you have painted on into the captured dataset, where the reconstruction reads them": (
        "Die bemalten Masken in den Datensatz der Aufnahme schreiben, wo die Rekonstruktion sie liest"
    ),
    "Show an image file in an Image Editor": "Eine Bilddatei in einem Bildeditor zeigen",
    "Mask Brush": "Maskenpinsel",
    "Show Image": "Bild zeigen",
    "Image": "Bild",
    "Image file": "Bilddatei",
    "Paint": "Malen",
    "What the brush does": "Was der Pinsel tut",
    "Erase what is not the object": "Radieren, was nicht zum Objekt gehört",
    "Add what is missing of the object": "Hinzufügen, was vom Objekt fehlt",
    "Set the Image Editor's mode to Paint": "Den Modus des Bildeditors auf Malen stellen",
    "1 mask saved": "1 Maske gespeichert",
    "{count} masks saved": "{count} Masken gespeichert",
    # Reconstruct
    ("Reconstruct a relightable object from photographs or a video, in the background. Missing options are taken from the IRGS++ panel"): (
        "Aus Fotos oder einem Video im Hintergrund ein Objekt rekonstruieren, das neu beleuchtet werden kann. Fehlende "
        "Optionen kommen aus dem Panel IRGS++"
    ),
    "Reconstruct the small dataset that comes with the extension, to check that everything works": (
        "Den kleinen Datensatz der Erweiterung rekonstruieren, um zu prüfen, ob alles funktioniert"
    ),
    "Run Demonstration": "Vorführung starten",
    "Demonstration": "Vorführung",
    "Folder of photographs, or a video; cameras that are not known are found": (
        "Ordner mit Fotos oder ein Video; unbekannte Kameras werden gesucht"
    ),
    "Folder for the results. Empty: next to the photographs' folder, with its name and _irgspp": (
        "Ordner für die Ergebnisse. Leer: neben dem Ordner der Fotos, mit seinem Namen und _irgspp"
    ),
    "Folder for the results": "Ordner für die Ergebnisse",
    "Single settings, as key=value separated by spaces": "Einzelne Einstellungen als key=value, durch Leerzeichen getrennt",
    "Continue the run in the folder, with its own settings": "Den Lauf im Ordner mit seinen eigenen Einstellungen fortsetzen",
    "Overwrite": "Überschreiben",
    "Replace the run in the folder": "Den Lauf im Ordner ersetzen",
    "The object has just been cut out by its sphere": "Das Objekt wurde gerade mit seiner Kugel ausgeschnitten",
    "Reconstruct again?": "Neu rekonstruieren?",
    "The run in the folder is replaced": "Der Lauf im Ordner wird ersetzt",
    "Replace": "Ersetzen",
    "Reconstruct {name}": "Rekonstruieren: {name}",
    "{job}: {state}; the reconstruction follows": "{job}: {state}; die Rekonstruktion folgt",
    "queued": "wartet",
    "running": "läuft",
    # Relight
    ('Relight the object with this scene\'s World in the image "IRGS++ Relight", updated while you work; scripts get a finished image'): (
        'Das Objekt mit der Welt dieser Szene im Bild "IRGS++ Relight" neu beleuchten, aktualisiert während der Arbeit; '
        "Skripte bekommen ein fertiges Bild"
    ),
    "Stop updating the image; it stays as it is": "Das Bild nicht mehr aktualisieren; es bleibt, wie es ist",
    "Save the World, whatever its nodes, as a lat-long environment map (.exr or .npy) that `irgspp render --environment` reads": (
        "Die Welt mit beliebigen Nodes als Umgebungskarte (.exr oder .npy) speichern, die `irgspp render --environment` liest"
    ),
    "Render views of a run as image files, lit by this scene's World or the recovered light": (
        "Ansichten eines Laufs als Bilddateien rendern, beleuchtet von der Welt dieser Szene oder dem gefundenen Licht"
    ),
    "Relight Preview": "Vorschau der neuen Beleuchtung",
    "World to Light Map": "Welt zu Lichtkarte",
    "Render Views": "Ansichten rendern",
    "Longest side of the image, in pixels": "Längste Seite des Bilds in Pixeln",
    "Height": "Höhe",
    "Rows of the map; it has twice as many columns": "Zeilen der Karte; sie hat doppelt so viele Spalten",
    "DATASET or DATASET:train|test|all, or a number of views on a circle. Empty: the run's dataset": (
        "DATASET oder DATASET:train|test|all oder eine Anzahl Ansichten auf einem Kreis. Leer: der Datensatz des Laufs"
    ),
    "Folder for the images. Empty: `relit` in the run folder": "Ordner für die Bilder. Leer: `relit` im Ordner des Laufs",
    "Light samples per pixel: hq, efficient or a number": "Lichtsamples je Pixel: hq, efficient oder eine Zahl",
    "The World is saved as {name}": "Die Welt ist als {name} gespeichert",
    "No preview is running": "Es läuft keine Vorschau",
    "The scene has no World": "Die Szene hat keine Welt",
    "Render {name}": "Rendern: {name}",
    # Result
    "Bake a run again: other textures, fewer triangles or an edited mesh. Smaller textures are made at once from the last bake": (
        "Einen Lauf neu backen: andere Texturen, weniger Dreiecke oder ein bearbeitetes Mesh. Kleinere Texturen entstehen "
        "sofort aus dem letzten Backen"
    ),
    ("Write a finished run's asset (.glb, .usdc, .usdz, .fbx, .obj), Blender scene (.blend), Gaussian splats (.ply) or light (.exr)"): (
        "Asset (.glb, .usdc, .usdz, .fbx, .obj), Blender-Szene (.blend), Gaussian Splats (.ply) oder Licht (.exr) eines "
        "fertigen Laufs schreiben"
    ),
    "Export IRGS++ Result": "IRGS++-Ergebnis exportieren",
    "Width and height of the textures, or of each UDIM tile, in texels; 0: as in the last bake": (
        "Breite und Höhe der Texturen, oder jeder UDIM-Kachel, in Texeln; 0: wie beim letzten Backen"
    ),
    "Name of a mesh object, edited or newly modelled, that replaces the run's mesh; its UVs are kept": (
        "Name eines bearbeiteten oder neu modellierten Mesh-Objekts, das das Mesh des Laufs ersetzt; seine UVs bleiben"
    ),
    "Bake {name}": "Backen: {name}",
    "Export {name}": "Exportieren: {name}",
    # True size and placement
    "Add two empties to the imported capture: move them, with snapping, to two points whose distance you know": (
        "Der importierten Aufnahme zwei Leerobjekte hinzufügen: sie mit Einrasten auf zwei Punkte setzen, deren Abstand bekannt ist"
    ),
    "Give the captured dataset its true size: the two measured points are as far apart as you say": (
        "Dem Datensatz der Aufnahme seine wahre Größe geben: die zwei gemessenen Punkte sind so weit auseinander wie angegeben"
    ),
    "Folder of a finished capture. Empty: the panel's": "Ordner einer fertigen Aufnahme. Leer: der des Panels",
    "Distance": "Abstand",
    "True distance of the measured points, in metres": "Wahrer Abstand der gemessenen Punkte in Metern",
    "Import": "Importieren",
    "Import the dataset again when it is done": "Den Datensatz neu importieren, wenn es fertig ist",
    "Set the true size of {name}": "Wahre Größe setzen: {name}",
    "Size in Blender, relative to the dataset's own units": "Größe in Blender im Verhältnis zu den Einheiten des Datensatzes",
}
