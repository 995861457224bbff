"""Access to the files of a Metashape project: a folder, a .psz, or a .psx with its .files folder of zip archives."""

import io
import zipfile
from pathlib import Path
from xml.etree import ElementTree

from jaxbundle.block.problems import BlockError, shown
from jaxbundle.io.formats.source import tree_of, wrong
from jaxbundle.io.text_files import UnreadableError, file_bytes

MAX_MEMBER = 2**31  # maximum bytes of one file in an archive


class Archive:
    """The files of a project: a folder, or nested zip archives."""

    def __init__(self, path: Path):
        self.path = path
        self.parts: dict[str, bytes] = {}
        files = path.with_suffix(".files")
        if path.is_dir():
            self.folder: Path | None = path
        elif path.suffix.lower() == ".psx":
            self.folder = None
            for archive in sorted(files.glob("*/chunk.zip")) + sorted(files.glob("*/*/frame.zip")):
                prefix = "" if archive.name == "chunk.zip" else "frame/"
                for name, data in _members(archive).items():
                    self.parts.setdefault(prefix + name, data)
        elif _starts(path, b"PK"):
            self.folder, self.parts = None, _members(path)
        else:
            self.folder = path.parent

    def read(self, name: str) -> bytes | None:
        """The content of a file with this name in the project; None where there is none."""
        if self.folder is not None:
            try:
                return file_bytes(self.folder / name)
            except UnreadableError:
                return None
        return self.parts.get(name)

    def document(self) -> ElementTree.Element:
        """The root of doc.xml, with the frame that a .psx has in a separate file."""
        data = self.read("doc.xml")
        if self.path.is_file() and not self.parts and self.folder is not None:
            data = file_bytes(self.path)
        if data is None:
            raise wrong(
                self.path, 0, "the project has no doc.xml", "give the .psz, or the .psx beside its .files folder"
            )
        root = tree_of(self.path, data)
        frame = self.read("frame/doc.xml")
        if frame is not None and root.find(".//frame") is None:
            chunk = root if root.tag == "chunk" else root.find(".//chunk")
            if chunk is not None:
                chunk.append(tree_of(self.path, frame))
        return root


def _starts(path: Path, begin: bytes) -> bool:
    try:
        return file_bytes(path, len(begin)) == begin
    except UnreadableError:
        return False


def _members(path: Path) -> dict[str, bytes]:
    """The files of a zip archive. Raises: BlockError for a damaged archive."""
    try:
        with zipfile.ZipFile(io.BytesIO(file_bytes(path))) as archive:
            large = [one.filename for one in archive.infolist() if one.file_size > MAX_MEMBER]
            if large:
                raise wrong(path, 0, f"{large[0]} in the archive is larger than {MAX_MEMBER} bytes", "unpack it")
            wanted = [one for one in archive.namelist() if one.endswith((".xml", ".ply"))]
            return {name: archive.read(name) for name in wanted}
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, OSError) as error:
        if isinstance(error, BlockError):
            raise
        raise wrong(path, 0, f"the archive is damaged: {shown(str(error))}", "copy or save it again") from error
    except UnreadableError as error:
        raise wrong(path, 0, error.what, error.cure) from error
