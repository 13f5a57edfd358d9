"""File names of maps: a name that says one format is not given to another."""

from pathlib import Path

from ogm_core.errors import BadParameter

_SUFFIXES = {
    *(".png", ".pgm", ".yaml", ".yml", ".json", ".npz"),
    *(".jpg", ".jpeg", ".gif", ".bmp", ".tif", ".tiff", ".webp", ".pdf", ".svg", ".npy", ".csv"),
}
"""Suffixes by which programs know a format; any other is part of a name."""


def check_suffix(path: Path, wanted: str) -> None:
    """Refuse a file name that ends as those of another format do than files of suffix `wanted`, ".png" say.

    Raises:
        BadParameter: it does; the text says what is needed.
    """
    suffix = path.suffix.lower()
    if suffix in _SUFFIXES - {wanted}:
        raise BadParameter(f"{path}: a file of this name is no {wanted[1:]} file: end it in {wanted}")


def ros_map_names(path: Path) -> tuple[Path, Path]:
    """The two files of a ROS map, NAME.pgm and NAME.yaml; `path` is one of them (or NAME.yml), or NAME alone.

    Raises:
        BadParameter: it is the name of another format's file, or no text, as a YAML file must name it.
    """
    suffix = path.suffix.lower()
    if suffix not in (".yaml", ".yml", ".pgm"):
        check_suffix(path, ".yaml")
        path = path.with_name(f"{path.name}.yaml")
    picture = path if suffix == ".pgm" else path.with_suffix(".pgm")
    check_text(picture.name, "the name of the picture, which the YAML file has to say")
    return picture, path.with_suffix(".yaml") if suffix == ".pgm" else path


def check_text(name: str, what: str) -> None:
    """Refuse a name of bytes that are no text.

    Raises:
        BadParameter: it is none; the text begins with `what`.
    """
    try:
        name.encode()
    except UnicodeEncodeError:
        raise BadParameter(f"{what}: {name!r} is not UTF-8 text: choose another name") from None
