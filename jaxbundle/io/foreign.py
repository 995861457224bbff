"""Recognising well-known formats that are not read, or not complete, in order to name them in messages."""

import codecs
from pathlib import Path

from jaxbundle.io.text_files import file_bytes, known_bytes

FOLDERS: tuple[tuple[str, tuple[str, ...]], ...] = (  # description, and files that must all exist
    ("a COLMAP model", ("cameras.bin", "images.bin")),
    ("a COLMAP model", ("cameras.txt", "images.txt")),
    ("a COLMAP project", ("database.db",)),
    ("a COLMAP project", ("sparse",)),
    ("an OpenSfM reconstruction", ("reconstruction.json",)),
    ("an OpenSfM project", ("camera_models.json",)),
    ("an OpenDroneMap project", ("odm_orthophoto",)),
    ("an OpenDroneMap project", ("opensfm",)),
    ("an OpenMVG project", ("sfm_data.json",)),
    ("an OpenMVG project", ("sfm_data.bin",)),
    ("a Meshroom project", ("cameras.sfm",)),
    ("an OPF project", ("project.opf",)),
    ("a Bundler project", ("bundle.out",)),
    ("a Bundler project", ("bundle", "list.txt")),
)
SQLITE, TABLE, SCHEMA = b"SQLite format 3\0", b"two_view_geometries", 65_536  # bytes that hold the names of the tables
DATABASE = "is a database of COLMAP, with measurements and matches and without orientations"
DATABASE_CURE = (
    "run the mapper of COLMAP on it and give the folder of the model that it makes (sparse/0), or measure the"
    " photographs with jaxbundle measure"
)
PATTERNS = (  # of files in a folder
    ("*.psx", "a Metashape project"),
    ("*.psz", "a Metashape project"),
    ("*.p4d", "a Pix4D project"),
    ("*_calibrated_camera_parameters.txt", "an export of Pix4D"),
    ("*.rcproj", "a RealityCapture project"),
    ("*.opf", "an OPF project"),
    ("Ori-*", "a MicMac project"),
    ("*.nvm", "a VisualSFM model"),
    ("geoin.dat", "a BINGO project"),
    ("*.prj", "an Inpho project"),
    ("*.im", "a PATB project"),
)
SUFFIXES = {
    ".psx": "a Metashape project",
    ".psz": "a Metashape project",
    ".p4d": "a Pix4D project",
    ".rcproj": "a RealityCapture project",
    ".opf": "an OPF project",
    ".nvm": "a VisualSFM model",
    ".prj": "an Inpho project",
    ".pmr": "a PhotoModeler project",
    ".las": "a point cloud (LAS)",
    ".laz": "a point cloud (LAZ)",
    ".ply": "a point cloud (PLY)",
    ".db": "a database, perhaps of COLMAP",
    ".sfm": "a Meshroom file",
    ".tif": "a picture",
    ".tiff": "a picture",
    ".jpg": "a picture",
    ".png": "a picture",
    ".zip": "a zip archive",
    ".xlsx": "a table of a spreadsheet program",
    ".ods": "a table of a spreadsheet program",
}
BEGINNINGS = (  # text in the first bytes of a file
    (b"# Bundle file", "a Bundler file"),
    (b"NVM_V3", "a VisualSFM model"),
    (b"# Camera list with one line of data per camera", "the cameras of a COLMAP model"),
    (b"# Image list with two lines of data per image", "the images of a COLMAP model"),
    (b"# 3D point list with one line of data per point", "the points of a COLMAP model"),
    (b"$PROJECT", "an Inpho project"),
    (b"<BlocksExchange", "a BlocksExchange file"),
    (b"<chunk", "an export of Metashape"),
    (b"<ExportAPERO", "a MicMac file"),
    (b'"sfm_data_version"', "an OpenMVG file"),
    (b'"cameras"', "an OpenSfM reconstruction"),
)


def known_folder(folder: Path) -> str:
    """Describes a folder, such as "a COLMAP model"; "" where its form is unknown."""
    for name, files in FOLDERS:
        if all((folder / file).exists() for file in files):
            return name
    return next((name for pattern, name in PATTERNS if next(folder.glob(pattern), None)), "")


def is_database(path: Path) -> bool:
    """Whether a file is a database of COLMAP."""
    data = file_bytes(path, SCHEMA)
    return data.startswith(SQLITE) and TABLE in data


def known_file(path: Path, head: bytes) -> str:
    """Describes a file that begins with `head`, such as "is compressed (gzip)"; "" if unknown."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "is text in UTF-16"
    said = known_bytes(head)
    if said:
        return said
    name = next((name for begin, name in BEGINNINGS if begin in head), SUFFIXES.get(path.suffix.lower(), ""))
    return f"is {name}" if name else ""
