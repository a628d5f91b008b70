# SPDX-License-Identifier: GPL-3.0-or-later
"""German texts of the properties."""

TEXTS: dict[str, str] = {
    # Dataset
    "Folder of photographs, or a video. Known cameras (transforms.json, COLMAP, ...) are used, others are found": (
        "Ordner mit Fotos oder ein Video. Bekannte Kameras (transforms.json, COLMAP, ...) werden verwendet, andere gesucht"
    ),
    "Folder of the .blend file when it was saved last": "Ordner der .blend-Datei, als sie zuletzt gespeichert wurde",
    "Description of the dataset by the engine, as JSON": "Beschreibung des Datensatzes durch die Engine als JSON",
    "Up": "Oben",
    "Axis of the dataset that becomes Blender's Z": "Achse des Datensatzes, die zu Blenders Z wird",
    "As It Is": "Wie sie ist",
    "Keep the up direction that the engine estimated": "Die Richtung nach oben behalten, die die Engine geschätzt hat",
    "+Y Up": "+Y oben",
    "The dataset's Y axis becomes Blender's Z": "Die Y-Achse des Datensatzes wird zu Blenders Z",
    "-Y Up": "-Y oben",
    "The dataset's Y axis points down, as in COLMAP": "Die Y-Achse des Datensatzes zeigt nach unten, wie in COLMAP",
    "+X Up": "+X oben",
    "The dataset's X axis becomes Blender's Z": "Die X-Achse des Datensatzes wird zu Blenders Z",
    "-X Up": "-X oben",
    "The dataset's X axis points down": "Die X-Achse des Datensatzes zeigt nach unten",
    "-Z Up": "-Z oben",
    "The dataset is upside down": "Der Datensatz steht auf dem Kopf",
    "+Z Up": "+Z oben",
    "Keep the dataset's own axes": "Die Achsen des Datensatzes behalten",
    "Scale": "Skalierung",
    "Scale of imported objects in Blender, relative to the dataset's own units": (
        "Skalierung importierter Objekte in Blender im Verhältnis zu den Einheiten des Datensatzes"
    ),
    "Recentre": "Zentrieren",
    "Move the object's centre to Blender's origin": "Die Mitte des Objekts auf Blenders Ursprung setzen",
    "Photographs Behind Cameras": "Fotos hinter Kameras",
    "Each camera shows its photograph when you look through it": "Jede Kamera zeigt ihr Foto, wenn man durch sie blickt",
    "Point Cloud": "Punktwolke",
    "Import the dataset's point cloud, if it has one": "Die Punktwolke des Datensatzes importieren, wenn er eine hat",
    "Marker (m)": "Marker (m)",
    (
        "Side of the black square of a printed ArUco or AprilTag marker in the photographs, in metres; the object then gets "
        "its true size. 0: no marker"
    ): (
        "Seite des schwarzen Quadrats eines gedruckten ArUco- oder AprilTag-Markers in den Fotos, in Metern; das Objekt "
        "bekommt dann seine wahre Größe. 0: kein Marker"
    ),
    "Distance (m)": "Abstand (m)",
    "True distance of the two measured points, in metres": "Wahrer Abstand der zwei gemessenen Punkte in Metern",
    "Turntable": "Drehteller",
    "The object turns before a fixed camera": "Das Objekt dreht sich vor einer festen Kamera",
    "Automatic": "Automatisch",
    "Decided by whether a background with texture stays at its place": (
        "Entschieden danach, ob ein Hintergrund mit Muster an seinem Platz bleibt"
    ),
    "Yes": "Ja",
    "The camera was fixed and the object turned before it": "Die Kamera stand fest, und das Objekt drehte sich vor ihr",
    "No": "Nein",
    "The camera moved around the object": "Die Kamera bewegte sich um das Objekt",
    # Reconstruct
    "Run Folder": "Ordner des Laufs",
    "Folder for the reconstruction's results. Empty: next to the photographs' folder, with its name and _irgspp": (
        "Ordner für die Ergebnisse der Rekonstruktion. Leer: neben dem Ordner der Fotos, mit seinem Namen und _irgspp"
    ),
    "Preset": "Voreinstellung",
    "Quality and duration of the reconstruction": "Güte und Dauer der Rekonstruktion",
    "Draft": "Entwurf",
    "For a first impression: photographs reduced to 320 pixels, few steps; about a minute": (
        "Für einen ersten Eindruck: Fotos auf 320 Pixel verkleinert, wenige Schritte; etwa eine Minute"
    ),
    "Balanced": "Mittel",
    "For most objects: photographs reduced to 640 pixels; several minutes on a CPU": (
        "Für die meisten Objekte: Fotos auf 640 Pixel verkleinert; einige Minuten auf einer CPU"
    ),
    "High": "Hoch",
    "For large photographs of fine detail: up to 1600 pixels, textures of 4096 or 8192; hours on a CPU": (
        "Für große Fotos mit feinen Einzelheiten: bis 1600 Pixel, Texturen von 4096 oder 8192; Stunden auf einer CPU"
    ),
    "Paper": "Artikel",
    "The published schedule: 50,000 steps, photographs of 800 pixels; hours, for a GPU": (
        "Der veröffentlichte Ablauf: 50.000 Schritte, Fotos von 800 Pixeln; Stunden, für eine GPU"
    ),
    "Material": "Material",
    "Material class of the object": "Materialklasse des Objekts",
    "Find Out": "Herausfinden",
    "Try both material classes briefly and keep the one that reproduces held-back photographs better": (
        "Beide Materialklassen kurz ausprobieren und die behalten, die zurückgehaltene Fotos besser wiedergibt"
    ),
    "Low Gloss": "Wenig Glanz",
    "Cloth, wood, plaster, plastic: the object reflects no clear images": (
        "Stoff, Holz, Gips, Kunststoff: das Objekt spiegelt keine klaren Bilder"
    ),
    "Glossy": "Glänzend",
    "Metal, glaze, lacquer: the object reflects its surroundings": "Metall, Glasur, Lack: das Objekt spiegelt seine Umgebung",
    "Device": "Gerät",
    "Hardware that computes the reconstruction": "Hardware, die die Rekonstruktion rechnet",
    "Best": "Bestes",
    "A graphics card if the engine can use one, otherwise the processor": (
        "Eine Grafikkarte, wenn die Engine eine nutzen kann, sonst der Prozessor"
    ),
    "The processor": "Der Prozessor",
    "An NVIDIA graphics card": "Eine NVIDIA-Grafikkarte",
    "Seed": "Startwert",
    "Seed of all random numbers: the same seed on the same machine gives the same result": (
        "Startwert aller Zufallszahlen: derselbe Startwert auf derselben Maschine ergibt dasselbe Ergebnis"
    ),
    "Settings": "Einstellungen",
    "Settings that replace those of the preset, as key=value separated by spaces, such as surface.texture=2048": (
        "Einstellungen, die die der Voreinstellung ersetzen, als key=value, durch Leerzeichen getrennt, etwa surface.texture=2048"
    ),
    "Show While Running": "Während des Laufs zeigen",
    "Show what the reconstruction has found so far in the 3D View: points at first, then the surface": (
        "In der 3D-Ansicht zeigen, was die Rekonstruktion bisher gefunden hat: zuerst Punkte, dann die Oberfläche"
    ),
    "Import When Done": "Importieren, wenn fertig",
    "Import the object into this scene when it is finished": "Das Objekt in diese Szene importieren, wenn es fertig ist",
    # Result
    "Material Reads": "Material liest",
    "Source of the values in the object's material": "Quelle der Werte im Material des Objekts",
    "The material reads textures through the UV map": "Das Material liest Texturen über die UV-Karte",
    "Attributes": "Attribute",
    "The material reads attributes at the mesh's vertices": "Das Material liest Attribute an den Ecken des Meshs",
    "Show Confidence": "Verlässlichkeit",
    (
        "Glow in the confidence of albedo (red), roughness (green) and metallic (blue) instead of reflecting light: white is"
        " well known, dark is not. Seen in Material Preview and in rendered views"
    ): (
        "Leuchten in der Verlässlichkeit von Albedo (rot), Rauheit (grün) und Metallanteil (blau), statt Licht zu spiegeln: "
        "Weiß ist gut bekannt, Dunkel nicht. Sichtbar in der Materialvorschau und in gerenderten Ansichten"
    ),
    "Pack": "Packen",
    "Keep textures and light inside the .blend instead of linking to the run folder": (
        "Texturen und Licht in der .blend-Datei behalten, statt auf den Ordner des Laufs zu verweisen"
    ),
    "Texture Size": "Texturgröße",
    "Width and height of the textures. A size below that of the last bake is made from this bake at once, which is kept": (
        "Breite und Höhe der Texturen. Eine kleinere Größe als die des letzten Backens entsteht sofort daraus; das Gebackene bleibt"
    ),
    "Textures of 1024 x 1024 texels": "Texturen von 1024 x 1024 Texeln",
    "Textures of 2048 x 2048 texels": "Texturen von 2048 x 2048 Texeln",
    "Textures of 4096 x 4096 texels": "Texturen von 4096 x 4096 Texeln",
    "Textures of 8192 x 8192 texels": "Texturen von 8192 x 8192 Texeln",
    "Bits": "Bits",
    "Bits of each value of albedo, roughness, metallic and normal textures. A .glb always has 8": (
        "Bits jedes Werts der Texturen von Albedo, Rauheit, Metall und Normalen. Eine .glb-Datei hat immer 8"
    ),
    "UDIM Tiles": "UDIM-Kacheln",
    "Tiles of this size along each side: 2 for 2 x 2, for more texels than one image holds; the UVs are packed again. "
    "1: one image; 0: as in the last bake, or by the edited mesh's UVs": (
        "Kacheln dieser Größe entlang jeder Seite: 2 für 2 x 2, für mehr Texel als in ein Bild passen; die UVs werden neu gepackt. "
        "1: ein Bild; 0: wie beim letzten Backen, oder nach den UVs des bearbeiteten Meshs"
    ),
    "As Before": "Wie zuvor",
    "As in the last bake": "Wie beim letzten Backen",
    "8 Bits": "8 Bit",
    "256 values, which every program reads": "256 Werte, die jedes Programm liest",
    "16 Bits": "16 Bit",
    "65,536 values: no steps in smooth gradients, twice the memory": (
        "65.536 Werte: keine Stufen in sanften Verläufen, doppelter Speicher"
    ),
    "Max Triangles": "Dreiecke höchstens",
    "Make a new mesh of at most so many triangles; 0 keeps the mesh as it is": (
        "Ein neues Mesh aus höchstens so vielen Dreiecken bilden; 0 lässt das Mesh, wie es ist"
    ),
    "Quads": "Vierecke",
    "Remesh the run's mesh to about so many quads, by QuadriFlow; 0 does not": (
        "Das Mesh des Laufs mit QuadriFlow aus etwa so vielen Vierecken neu bilden; 0 tut es nicht"
    ),
    "Height Texture": "Höhentextur",
    "Also bake how far the surface as it was fused lies above a mesh of fewer triangles, for displacement": (
        "Auch backen, wie weit die fusionierte Oberfläche über einem Mesh aus weniger Dreiecken liegt, für die Verschiebung"
    ),
    "Displacement": "Verschiebung",
    "Displace the mesh by its height texture in renders. Subdivide it first: a Subdivision Surface modifier set to Simple": (
        "Das Mesh beim Rendern um seine Höhentextur verschieben. Es vorher unterteilen: mit einem Modifikator "
        "Unterteilungsfläche, auf Einfach gestellt"
    ),
    "Edited Mesh": "Bearbeitetes Mesh",
    "Mesh that you edited or modelled, to bake the textures onto. Empty: the run's own mesh": (
        "Bearbeitetes oder modelliertes Mesh, auf das die Texturen gebacken werden. Leer: das Mesh des Laufs"
    ),
    # Export
    "Levels of Detail": "Detailstufen",
    "Add versions with a half and a quarter of the triangles, which share the textures": (
        "Fassungen mit der Hälfte und einem Viertel der Dreiecke hinzufügen, die sich die Texturen teilen"
    ),
    "Datablock that becomes the asset": "Datenblock, der zum Asset wird",
    "The object with levels of detail and collision hulls; placed as an instance or appended": (
        "Das Objekt mit Detailstufen und Kollisionshüllen; als Instanz platziert oder angehängt"
    ),
    "Collection": "Sammlung",
    "Object": "Objekt",
    "The object alone": "Nur das Objekt",
    "Occlusion": "Verdeckung",
    "Trace how open each place of the surface is, for seconds: red of orm.png, and the occlusion texture of .glb": (
        "Sekundenlang verfolgen, wie offen jede Stelle der Oberfläche ist: Rot von orm.png, und die Verdeckungstextur von .glb"
    ),
    "As in the Scene": "Wie in der Szene",
    "Turn and scale the export as the object is turned and scaled in the scene; off: as it was reconstructed": (
        "Den Export so drehen und skalieren, wie das Objekt in der Szene gedreht und skaliert ist; aus: so wie rekonstruiert"
    ),
    "Collision Hulls": "Kollisionshüllen",
    "Add a few convex solids that game engines take as the collision shape (UCX_...)": (
        "Einige konvexe Körper hinzufügen, die Spiele-Engines als Kollisionsform nehmen (UCX_...)"
    ),
    "Place of the textures": "Ort der Texturen",
    "Inside the file where its format can, otherwise beside it": "In der Datei, wo ihr Format es kann, sonst daneben",
    "Inside": "Innen",
    "Inside the file": "In der Datei",
    "Beside": "Daneben",
    "In a folder beside the file, which is found when both are moved together": (
        "In einem Ordner neben der Datei, der gefunden wird, wenn beide zusammen verschoben werden"
    ),
    "As UDIM tiles in a folder beside the file. Bake them first; not every program finds them by itself": (
        "Als UDIM-Kacheln in einem Ordner neben der Datei. Sie werden zuerst gebacken; nicht jedes Programm findet sie von selbst"
    ),
    "Normal Map": "Normalenkarte",
    "Direction of green in the normal map of .fbx and .obj": "Richtung von Grün in der Normalenkarte von .fbx und .obj",
    "OpenGL": "OpenGL",
    "Green is up, as in Blender, Unity and Godot": "Grün ist oben, wie in Blender, Unity und Godot",
    "DirectX": "DirectX",
    "Green is down, as in Unreal Engine; .fbx and .obj only": "Grün ist unten, wie in der Unreal Engine; nur .fbx und .obj",
    # Relight
    "Light from World": "Licht der Welt",
    "Light the object by this scene's World; otherwise by the recovered light": (
        "Das Objekt mit der Welt dieser Szene beleuchten; sonst mit dem gefundenen Licht"
    ),
    "Lamps": "Lampen",
    "Sun, point, spot and area lamps of the scene light the object as well": (
        "Sonnen-, Punkt-, Spot- und Flächenlampen der Szene beleuchten das Objekt auch"
    ),
    "Ground Shadow": "Bodenschatten",
    "The object casts its shadow on an invisible level ground at its foot: the shadow is in the image's alpha": (
        "Das Objekt wirft seinen Schatten auf einen unsichtbaren ebenen Boden an seinem Fuß: der Schatten steht im Alpha des Bilds"
    ),
    "Samples": "Samples",
    "Light samples per pixel of the finished image: more samples, less noise": (
        "Lichtsamples je Pixel des fertigen Bilds: mehr Samples, weniger Rauschen"
    ),
    "Denoise": "Entrauschen",
    "Smooth the noise of few samples without blurring edges": "Das Rauschen weniger Samples glätten, ohne Kanten zu verwischen",
    "Trace": "Verfolgen auf",
    "Geometry on which shadows and reflections are traced": "Geometrie, auf der Schatten und Spiegelungen verfolgt werden",
    "Mesh": "Mesh",
    "Trace shadows and reflections between parts of the object on its mesh: fast": (
        "Schatten und Spiegelungen zwischen Teilen des Objekts auf seinem Mesh verfolgen: schnell"
    ),
    "Gaussians": "Gaußfunktionen",
    "Trace them through the fitted Gaussians: slower, but exactly as reconstructed": (
        "Sie durch die angepassten Gaußfunktionen verfolgen: langsamer, aber genau wie rekonstruiert"
    ),
    "Seen From": "Gesehen von",
    "Point of view of the image": "Standpunkt des Bilds",
    "Camera": "Kamera",
    "Look through the scene's camera": "Durch die Kamera der Szene blicken",
    "3D View": "3D-Ansicht",
    "Look from the same place as this 3D View": "Vom selben Platz blicken wie diese 3D-Ansicht",
    "Resolution": "Auflösung",
    "Longest side of the preview in pixels": "Längste Seite der Vorschau in Pixeln",
    "Job": "Auftrag",
    "The job whose details are shown": "Der Auftrag, dessen Einzelheiten gezeigt werden",
    # Comparison
    "Comparison": "Vergleich",
    "How photograph and result are compared, seen through the photograph's camera": (
        "Wie Foto und Ergebnis verglichen werden, durch die Kamera des Fotos gesehen"
    ),
    "Split": "Geteilt",
    "The photograph on the left of a border, the result on the right": "Links von einer Grenze das Foto, rechts das Ergebnis",
    "Fade": "Überblenden",
    "The photograph fades over the result": "Das Foto wird über das Ergebnis geblendet",
    "Border": "Grenze",
    "Place of the border between photograph and result: 0 shows the result alone, 1 the photograph": (
        "Ort der Grenze zwischen Foto und Ergebnis: 0 zeigt nur das Ergebnis, 1 das Foto"
    ),
    "Photograph over Object": "Foto über dem Objekt",
    "Opacity of the photograph in front of the object, seen through its camera: 0 shows the object, 1 the photograph": (
        "Deckkraft des Fotos vor dem Objekt, durch dessen Kamera gesehen: 0 zeigt das Objekt, 1 das Foto"
    ),
}
