"""Reading XML of unknown origin."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError

_LARGEST: Final = 200_000_000
_DEEPEST: Final = 200


def read_xml(path: Path | str) -> etree._Element:
    """Root of an XML file; entities are never resolved and nothing is fetched.

    Parameters
    ----------
    path : path
        At most 200 MB, nested at most 200 deep.

    Returns
    -------
    lxml element

    Raises
    ------
    InputError
        The file cannot be read, is no XML, has a document type declaration, or is too large or too deep.
    """
    path = Path(path)
    try:
        # A device or a pipe may never end.
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a file.")
        size = path.stat().st_size
        if size > _LARGEST:
            raise InputError(f"{path}: has {size} bytes; at most {_LARGEST} are read.")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=False
    )
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        raise InputError(f"{path}: is not well-formed XML ({error.msg}).") from error
    if root.getroottree().docinfo.internalDTD is not None:
        raise InputError(f"{path}: has a document type declaration, which is not read; remove <!DOCTYPE …>.")
    depth = 0
    for event, _ in etree.iterwalk(root, events=("start", "end")):
        depth += 1 if event == "start" else -1
        if depth > _DEEPEST:
            raise InputError(f"{path}: elements are nested more than {_DEEPEST} deep.")
    return root
