"""The two images of a pair, of one size and one range of samples."""

from __future__ import annotations

from pathlib import Path

from depthcli.core.errors import InputError
from depthcli.core.frames import Image, StereoPair, luma
from depthcli.io.formats.files import naming, read_bytes, shown
from depthcli.io.formats.headers import image_kind, png_chunks, pnm_header
from depthcli.io.formats.images import decode_image


def read_pair(left: Path | str, right: Path | str) -> StereoPair:
    """Return a rectified pair; the range of 10- and 12-bit samples in 16-bit files is declared or found.

    Raises
    ------
    InputError
        As :func:`read_image`, or the images differ in size or type.
    """
    images, declared = [], []
    for path in (left, right):
        data = read_bytes(path)
        with naming(path):
            images.append(decode_image(data))
            declared.append(_declared_bits(data))
    said = declared[0] if declared[0] == declared[1] else None
    return pair_of(images[0], images[1], (Path(left), Path(right)), said)


def pair_of(left: Image, right: Image, paths: tuple[Path, Path], declared: int | None = None) -> StereoPair:
    """Return two images as a pair; where one is grey and the other color, both become grey.

    Parameters
    ----------
    paths : the files, for messages
    declared : bits of the samples, where the files say them

    Raises
    ------
    InputError
        The images differ in size or type.
    """
    if left.shape[:2] != right.shape[:2] or left.dtype != right.dtype:
        raise InputError(
            f"{shown(paths[1])}: {_kind(right)}, but {shown(paths[0].name)} is {_kind(left)}; the pair must agree"
        )
    bits = sample_bits(left, right, declared=declared)
    if left.ndim != right.ndim:
        # Grey levels of one scale: luma of the color image, in as many bits as it is stored.
        left, right = (luma(image) for image in (left, right))
    return StereoPair(left, right, bits)


def sample_bits(*images: Image, declared: int | None = None) -> int:
    """Return the bits of the samples of images that share one scale: 8, 16, or what 16-bit files hold.

    Parameters
    ----------
    images : uint8 or uint16, of one type
    declared : what the files say; believed where no sample is larger

    Returns
    -------
    ``declared``; else 10 or 12 where no sample of any image is larger than 1023 or 4095; else the type's bits
    """
    bits = 8 * images[0].dtype.itemsize
    top = max(int(image.max()) for image in images)
    if declared is not None and declared <= bits and top < 1 << declared:
        return declared if bits == 16 else bits
    return next((used for used in (10, 12) if top < 1 << used), bits) if bits == 16 else bits


def _declared_bits(data: bytes) -> int | None:
    """Bits of a sample that carry something, where a PNG (sBIT) or PNM (its maximum) says so; else None.

    A maximum of all ones says nothing: most programs write it whatever the camera gave.
    """
    kind = image_kind(data)
    if kind == "png":
        bits = next((chunk[8:-4] for name, chunk in png_chunks(data) if name == b"sBIT"), b"")
        return max(bits, default=0) or None
    if kind == "pnm":
        top = pnm_header(data).top
        return None if top in (255, 65535) else top.bit_length()
    return None


def _kind(image: Image) -> str:
    color = "grey" if image.ndim == 2 else "colour"
    return f"{image.shape[1]} x {image.shape[0]} {color} {image.dtype}"
