"""Which files a model refers to, directly or through included and attached models."""

import posixpath
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable

from planspace.errors import PlanspaceError
from planspace.mjcf.model_budget import check_budget
from planspace.mjcf.model_check import FILE_ATTRIBUTES, check_assets, parse_model
from planspace.mjcf.source import is_inside, outside

ReadFile = Callable[[str], bytes | None]
"""Path below the root folder to a file's content, or None if it does not exist."""
LEFT_OUT = {"texture"}
"""Elements whose files are replaced by a plain colour."""
_FOLDER_ATTRIBUTES = ("meshdir", "assetdir")
"""Attributes of `compiler` that name the folder of a model's meshes."""


def referred_files(main: str, read: ReadFile, where: str) -> dict[str, bytes]:
    """Find the files that a model refers to, and check what all of them request together.

    Args:
        main: path of the main file below the root folder.
        read: reads a file.
        where: the main file, for messages.

    Returns:
        Path and content of each file, without the main file. A file that does not exist is left out, so that
        MuJoCo names it when it compiles the model; textures are left out, too.

    Raises:
        PlanspaceError: a file lies outside the root folder, is damaged, is not MJCF, or includes itself, or
            the model requests too much.
    """
    walk = _Walk(main, read, where)
    root = walk.parse(main)
    walk.follow(main, root, (main,))
    walk.add_assets()
    check_budget(root, where)
    check_assets([(name, walk.found[name]) for name in walk.references], where)
    return walk.found


class _Walk:
    """The files found so far."""

    def __init__(self, main: str, read: ReadFile, where: str):
        self.found: dict[str, bytes] = {}
        self.references: list[str] = []
        self._main, self._read, self._where = main, read, where
        self._trees: dict[str, ElementTree.Element] = {}
        self._included: set[str] = {main}

    def parse(self, name: str) -> ElementTree.Element:
        """Parse a model file."""
        data = self._read(name)
        if data is None:
            raise PlanspaceError(f"cannot read {self._place(name)}: No such file or directory.")
        if name != self._main:
            self.found[name] = data
        try:
            self._trees[name] = parse_model(data.decode(), self._place(name))
        except UnicodeDecodeError as error:
            raise PlanspaceError(f"{self._place(name)} is not a text file: {error}.") from error
        return self._trees[name]

    def follow(self, name: str, root: ElementTree.Element, path: tuple[str, ...]) -> None:
        """Parse the models that a file includes and attaches, and insert their trees into its own."""
        attached = {}
        for element in list(root.iter("include")):
            file = self._locate(name, element.get("file", ""))
            if file in self._included:
                raise PlanspaceError(
                    f"{self._place(name)} includes {element.get('file')!r} twice, or in a circle."
                )
            self._included.add(file)
            tree = self.parse(file)
            self.follow(file, tree, (*path, file))
            element.extend(tree)
        for element in [e for e in root.iter("model") if "file" in e.attrib]:
            file = self._locate(name, element.attrib["file"])
            if file in path:
                raise PlanspaceError(f"{self._place(name)} attaches {element.attrib['file']!r} to itself.")
            tree = self.parse(file)
            self.follow(file, tree, (*path, file))
            attached[element.get("name") or tree.get("model", "")] = tree
        for element in root.iter("attach"):
            if (tree := attached.get(element.get("model", ""))) is not None:
                element.append(tree)

    def add_assets(self) -> None:
        """Find the meshes and other files. MuJoCo takes their folders from any file's `compiler` for all."""
        compilers = [element.attrib for tree in self._trees.values() for element in tree.iter("compiler")]
        folders = sorted({"", *(c[a] for c in compilers for a in _FOLDER_ATTRIBUTES if a in c)})
        for name, tree in self._trees.items():
            for element in tree.iter():
                if element.tag in ("include", "model") or element.tag in LEFT_OUT:
                    continue
                for attribute in sorted(FILE_ATTRIBUTES & element.attrib.keys()):
                    self._add_asset(name, element.attrib[attribute], folders)

    def _locate(self, name: str, file: str) -> str:
        """The path of a model file that another one names, relative to the main file or to itself."""
        places = self._places(name, file, [""])
        return next((place for place in places if self._read(place) is not None), places[0])

    def _add_asset(self, name: str, file: str, folders: list[str]) -> None:
        for place in self._places(name, file, folders):
            if (data := self._read(place)) is not None:
                self.found[place] = data
                self.references.append(place)  # MuJoCo reads a file once for each reference

    def _places(self, name: str, file: str, folders: list[str]) -> list[str]:
        """The paths below the root folder that a file name can stand for.

        Raises:
            PlanspaceError: none of them is below the root folder.
        """
        bases = dict.fromkeys((posixpath.dirname(self._main), posixpath.dirname(name)))
        paths = [posixpath.join(base, folder, file) for base in bases for folder in folders]
        inside = [posixpath.normpath(path) for path in paths if is_inside(path)]
        if len(inside) < len(paths) and not any(self._read(place) is not None for place in inside):
            raise outside(file, self._place(name))
        return inside

    def _place(self, name: str) -> str:
        return self._where if name == self._main else posixpath.join(posixpath.dirname(self._where), name)
