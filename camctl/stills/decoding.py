"""Samples in the files of still cameras: JPEG, PNG, TIFF and camera raw.

A file may be damaged, cut short or malicious.  Whatever its bytes are, the result is pixels or one
typed error, and memory is limited by what a file of that length can hold (`_check_size`).

OpenCV and tifffile are imported when the first file is read, since listing cameras needs neither.
"""

from __future__ import annotations

import io
import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CameraProtocolError, UsageError
from camctl.interface.colour import BT709_PRIMARIES, D65, CameraColour, rgb_to_xyz
from camctl.interface.layout import BRIGHTNESS_STEPS, FEW_CHROMA_SAMPLES, Layout, Pixels
from camctl.stills.colour import stated_colour
from camctl.stills.exif import PNG, png_chunks
from camctl.stills.jpeg import CUT_SHORT, JpegStructure
from camctl.system.library_output import quiet_libraries, with_messages
from camctl.system.picture_operations import required_opencv

if TYPE_CHECKING:
    from camctl.profiles.profile import StillRecord

# The largest pictures of still cameras (medium format with pixel shift) have 400 million pixels.
MAX_PIXELS = 1 << 29

# Deflate compresses by 1032 at most (zlib's technical notes).  A JPEG needs at least one bit for
# the first coefficient of each block of 64 pixels: 512 pixels a byte at most.
_MAX_PIXELS_PER_BYTE = 1040

_LEAST_RAW_BYTES = 16  # a header and one directory entry of TIFF, the frame of most raw formats
_JPEG = b"\xff\xd8\xff"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_TIFF_SUFFIXES = (".tif", ".tiff")
# Of ISO 23008-12 (HEIF) and of AVIF.
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1", b"avif", b"avis")
# What containers of video begin with: of ISO 14496-12 the brands after "ftyp" (Canon's raw files
# have "crx "), of AVI the name of a RIFF file, of Matroska and WebM that of an EBML file.
_VIDEO_BRANDS = (b"iso", b"mp4", b"avc", b"qt", b"M4V", b"3g", b"MSNV", b"XAVC", b"dash", b"mmp4")
_MATROSKA = b"\x1a\x45\xdf\xa3"
# What pictures that no camera writes begin with, from a place on.
_OTHER_PICTURES = {"WebP": (8, b"WEBP"), "GIF": (0, b"GIF8"), "BMP": (0, b"BM")}
_DNG_VERSION = 50706
_MIN_IS_BLACK, _RGB = 1, 2  # TIFF 6.0, PhotometricInterpretation

# LibRaw's names of 2 x 2 colour filter patterns, row by row.
_PATTERNS = {
    "RGGB": Layout.RGGB,
    "GRBG": Layout.GRBG,
    "GBRG": Layout.GBRG,
    "BGGR": Layout.BGGR,
}


@dataclass(frozen=True, eq=False)
class Still:
    """The contents of one file.

    Attributes:
        pixels: (rows, columns), or (rows, columns, 3) in the order red, green, blue; uint8 up to
            8 bits, else uint16
        layout: pixel layout; a grey file with three channels is RGB
        bits: bits per sample
        black: brightness without light, DN
        white: brightness from which a sample is saturated, DN
        notes: what the user should know, one line each
        colour: what its R, G and B are; None: not known
        invalid: which pixels its alpha channel leaves out, (rows, columns); None: none
        few_chroma_samples: whether it states fewer samples of the differences of colours than of
            brightness, as JPEG files of 4:2:0 and 4:2:2 do
        brightness_steps: what the 64 frequencies of brightness of a block are multiples of in it,
            row by row, levels; empty where there are none
    """

    pixels: Pixels
    layout: Layout
    bits: int
    black: int
    white: int
    notes: tuple[str, ...] = ()
    colour: CameraColour | None = None
    invalid: NDArray[np.bool_] | None = None
    few_chroma_samples: bool = False
    brightness_steps: tuple[int, ...] = ()

    @property
    def details(self) -> dict[str, Any]:
        """What `Frame.details` has of it."""
        few = {FEW_CHROMA_SAMPLES: True} if self.few_chroma_samples else {}
        return few | ({BRIGHTNESS_STEPS: self.brightness_steps} if self.brightness_steps else {})

    @property
    def record(self) -> StillRecord:
        """Size, layout and levels of the file, as a camera's profile keeps them."""
        from camctl.profiles.profile import StillRecord

        rows, columns = self.pixels.shape[:2]
        return StillRecord(
            rows=rows,
            columns=columns,
            layout=self.layout,
            bits=self.bits,
            black=self.black,
            white=self.white,
        )


def read_still(data: bytes, name: str) -> Still:
    """Return the contents of a camera's file, recognised by its first bytes and by its name.

    Raw files give the unchanged samples of the visible part of the sensor: not demosaiced, not
    scaled, black level included.  If the black levels of the four colours differ, the samples of
    each colour are raised by a whole number of levels, so that the highest holds for all.

    Args:
        data: the whole file
        name: its name on the camera, for its suffix and for errors

    Raises:
        CameraProtocolError: it is damaged, cut short, or of an unknown format
        UsageError: the package that reads this format is not installed
    """
    with quiet_libraries():
        still = _read(data, name)
        if still.layout is Layout.RGB and still.colour is None:
            still = replace(still, colour=stated_colour(data))
        return still


def _read(data: bytes, name: str) -> Still:
    suffix = PurePath(name).suffix.lower()
    if data.startswith(_JPEG):
        return _read_jpeg(data, name)
    if data.startswith(PNG):
        return _read_png(data, name)
    if data.startswith(_TIFF):
        return _read_tiff_family(data, name, is_plain=suffix in _TIFF_SUFFIXES)
    if data[4:8] == b"ftyp" and data[8:12] in _HEIF_BRANDS:
        raise UsageError(
            f"{name} is a HEIF picture (HEIC or AVIF), which is not read",
            hint="convert it to TIFF of 16 bits, for instance with darktable, or shoot JPEG or raw",
        )
    if _is_video(data):
        raise UsageError(
            f"{name} is a video, and photographs are needed",
            hint="take photographs of several exposures; frames of a video serve where the "
            "exposure of each is known: save them as PNG files, for instance with ffmpeg, and give "
            "their times",
        )
    for kind, (place, begin) in _OTHER_PICTURES.items():
        if data.startswith(begin, place):
            raise UsageError(
                f"{name} is a {kind} picture, which is not read",
                hint="give the camera's own file, or convert it to PNG and give its time",
            )
    if len(data) < _LEAST_RAW_BYTES:
        raise _damaged(name, f"it has only {len(data)} bytes")
    return _read_raw(data, name)


def _is_video(data: bytes) -> bool:
    if data[4:8] == b"ftyp":
        return data[8:12].startswith(_VIDEO_BRANDS)
    return data.startswith(_MATROSKA) or (data[:4] == b"RIFF" and data[8:12] == b"AVI ")


def _damaged(name: str, why: str) -> CameraProtocolError:
    return CameraProtocolError(
        f"the camera's file {name or '(no name)'} cannot be read: {why}", hint="shoot it again"
    )


def _not_read(name: str, kind: str) -> UsageError:
    return UsageError(
        f"{name} is {kind}, which is not read",
        hint="convert it to TIFF or PNG of 8 or 16 bits, grey or RGB",
    )


def _check_size(name: str, rows: int, columns: int, bytes_in_file: int) -> None:
    """Reject sizes that no camera has, or that a file of this length cannot hold."""
    pixels = rows * columns
    if not (0 < pixels <= MAX_PIXELS and pixels <= _MAX_PIXELS_PER_BYTE * bytes_in_file):
        raise _damaged(name, f"it states {columns} x {rows} pixels in {bytes_in_file} bytes")


# ---- JPEG and PNG


def _read_jpeg(data: bytes, name: str) -> Still:
    structure = JpegStructure.of(data)
    rows = structure.rows
    if rows:
        _check_size(name, rows, structure.columns, len(data))
    if structure.is_cmyk:
        raise UsageError(
            f"{name} is a JPEG of four inks (CMYK), which is not read",
            hint="convert it to RGB (sRGB), or take the camera's own file",
        )
    if structure.why:
        is_cut = structure.why == CUT_SHORT and rows
        known = structure.undamaged_rows(data, _printed) if is_cut else None
        missing = "" if known is None else f": what is below row {known} of {rows} is missing"
        raise _damaged(name, structure.why + missing)
    if (zeros := structure.zeros(data)) is not None:
        known = JpegStructure.of(data[:zeros]).undamaged_rows(data[:zeros], _printed)
        raise _damaged(name, f"its data from row {known} of {rows} on are damaged (zeros)")
    still, text = with_messages(lambda: _decode(data, name, is_colour=structure.is_colour))
    still = replace(
        still,
        few_chroma_samples=structure.few_chroma_samples,
        brightness_steps=structure.brightness_steps,
    )
    if damage := structure.damage(data, text):
        known = structure.undamaged_rows(data, _printed)
        where = "" if known is None else f" in or above row {known + 1} of {rows}"
        raise _damaged(name, f"its data are damaged{where if known != rows else ''} ({damage})")
    if count := structure.remaining_bytes(data, text):
        note = (
            f"{count} bytes remain after the last row: the file is damaged, or the camera wrote "
            "data of its own"
        )
        return replace(still, notes=(note,))
    return still


def _printed(data: bytes) -> str:
    """Return what OpenCV prints when it decodes a JPEG."""
    import cv2

    buffer = np.frombuffer(data, np.uint8)
    return with_messages(lambda: cv2.imdecode(buffer, cv2.IMREAD_REDUCED_GRAYSCALE_8))[1]


def _read_png(data: bytes, name: str) -> Still:
    size = None
    for kind, start, end in png_chunks(data):
        if zlib.crc32(memoryview(data)[start - 4 : end]) != int.from_bytes(data[end : end + 4]):
            kind_name = kind.decode("latin-1")
            raise _damaged(name, f"the checksum of its chunk {kind_name} is wrong")
        if kind == b"IHDR" and end - start == 13:
            columns, rows = struct.unpack_from(">II", data, start)
            size = (rows, columns)
        if kind == b"IEND":
            if size is None:
                break
            _check_size(name, *size, len(data))
            return _decode(data, name)
    raise _damaged(name, CUT_SHORT)


def _decode(data: bytes, name: str, *, is_colour: bool = False) -> Still:
    """Return what OpenCV decodes; of a JPEG file of colours `is_colour` saves a pass over it."""
    cv2 = required_opencv("decoding JPEG, PNG and TIFF files of cameras")
    flags = cv2.IMREAD_UNCHANGED
    if is_rgb := is_colour and hasattr(cv2, "IMREAD_COLOR_RGB"):  # from OpenCV 4.11 on
        flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise _damaged(name, error.err or "OpenCV cannot decode it") from None
    if image is None:
        raise _damaged(name, "OpenCV cannot decode it")
    if not is_rgb and image.ndim == 3 and image.shape[2] in (3, 4):
        rgb = cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA
        image = cv2.cvtColor(image, rgb, image)  # in place: a third of the time
    return _full_range(np.asarray(image), name)


def _full_range(image: NDArray[Any], name: str) -> Still:
    """Return grey or RGB samples of 8 or 16 bits, whose white level is the largest code."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.dtype not in (np.uint8, np.uint16):
        raise _not_read(name, f"a picture of {image.dtype} samples")
    invalid = None
    if image.ndim == 3 and image.shape[2] in (2, 4):
        # What is transparent, entirely or in part, is not valid.
        invalid = image[:, :, -1] < np.iinfo(image.dtype).max
        image = image[:, :, 0] if image.shape[2] == 2 else image[:, :, :3]
        invalid = invalid if invalid.any() and not invalid.all() else None
    if image.ndim != 2 and not (image.ndim == 3 and image.shape[2] == 3):
        raise _not_read(name, f"an array of shape {image.shape}")
    bits = 8 * image.dtype.itemsize
    return Still(
        np.ascontiguousarray(image),
        Layout.MONO if image.ndim == 2 else Layout.RGB,
        bits,
        black=0,
        white=2**bits - 1,
        invalid=invalid,
    )


# ---- TIFF, and the raw formats that are built like one (DNG, NEF, CR2, ARW, ...)


def _read_tiff_family(data: bytes, name: str, *, is_plain: bool) -> Still:
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            if not len(file.pages):
                raise _damaged(name, "it holds no picture")
            page = file.pages.first
            is_plain = is_plain and _DNG_VERSION not in page.tags
            _check_segments(page, name, len(data))
            for offset in page.subifds or () if not is_plain else ():
                if not 0 <= offset < len(data):
                    raise _damaged(name, "a directory lies beyond its end")
            if is_plain:
                return _read_page(page, name, data)
    except (CameraProtocolError, UsageError):
        raise
    except Exception as error:  # a damaged tag can cause any error in tifffile
        raise _damaged(name, f"{type(error).__name__}: {error}".splitlines()[0]) from None
    return _read_raw(data, name)


def _check_segments(page: Any, name: str, bytes_in_file: int) -> None:
    segments = zip(page.dataoffsets, page.databytecounts, strict=False)
    if any(offset + count > bytes_in_file for offset, count in segments):
        raise _damaged(name, CUT_SHORT)


def _read_page(page: Any, name: str, data: bytes) -> Still:
    bytes_in_file = len(data)
    _check_size(name, page.imagelength, page.imagewidth, bytes_in_file)
    _check_size(name, page.imagelength, page.imagewidth * page.samplesperpixel, bytes_in_file)
    if page.photometric not in (_MIN_IS_BLACK, _RGB):
        raise _not_read(name, f"a TIFF of photometric interpretation {_photometric(page)}")
    if page.bitspersample not in (8, 16) or page.imagedepth != 1:
        raise _not_read(name, f"a TIFF of {page.bitspersample} bits a sample")
    if not page.dataoffsets or len(page.dataoffsets) != len(page.databytecounts):
        raise _damaged(name, "the positions of its samples are missing")
    try:
        image = page.asarray(maxworkers=1)
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
        return _decode_tiff(data, name)
    if page.planarconfig == 2 and image.ndim == 3:
        image = np.moveaxis(image, 0, -1)
    return _full_range(image, name)


def _photometric(page: Any) -> str:
    number = page.photometric
    return f"{int(number)} ({getattr(number, 'name', 'unknown').lower()})"


def _decode_tiff(data: bytes, name: str) -> Still:
    """Return what OpenCV reads of a compression that tifffile reads with imagecodecs alone."""
    try:
        return _decode(data, name)
    except CameraProtocolError:
        raise UsageError(
            f"{name} is a TIFF of a compression that needs imagecodecs, which is not installed",
            hint="pip install 'camctl[tiff]'",
        ) from None


# ---- camera raw


def _read_raw(data: bytes, name: str) -> Still:
    try:
        import rawpy
    except ImportError:
        raise UsageError(
            f"{name} is camera raw, and rawpy is not installed", hint="pip install 'camctl[raw]'"
        ) from None
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            sizes = raw.sizes
            _check_size(name, sizes.raw_height, sizes.raw_width, len(data))
            return _mosaic(raw, name)
    except (rawpy.LibRawIOError, rawpy.LibRawFileUnsupportedError):
        raise _damaged(name, "it is no picture of a known format, or cut short") from None
    except rawpy.LibRawError as error:
        text = error.args[0] if error.args else type(error).__name__
        reason = text.decode("ascii", "replace") if isinstance(text, bytes) else str(text)
        raise _damaged(name, reason) from None


def _mosaic(raw: Any, name: str) -> Still:
    samples: NDArray[np.uint16] = raw.raw_image_visible
    if samples is None or samples.size == 0:
        raise _damaged(name, "it has no samples")
    blacks = [int(level) for level in raw.black_level_per_channel]
    whites = [int(level) for level in raw.camera_white_level_per_channel or ()]
    white = min([int(raw.white_level), *(level for level in whites if level > max(blacks))])
    layout, channels = _layout(raw, samples, name)
    black = max(blacks[int(channel)] for channel in np.unique(channels))
    if not 0 <= black < white < 1 << 16:
        raise _damaged(name, f"its black level is {black} and its white level {white}")
    colour = None if layout is Layout.MONO else _raw_colour(raw)
    bits = white.bit_length()
    pixels = np.minimum(samples, np.uint16(2**bits - 1))
    raise_by = np.array([black - level for level in blacks])[channels]
    notes: tuple[str, ...] = ()
    if np.any(raise_by):
        _raise_blacks(pixels, raise_by, 2**bits - 1)
        notes = (
            f"the black levels of the colours differ ({', '.join(map(str, blacks))}): all samples "
            f"were raised to black level {black}",
        )
    if bits <= 8:
        return Still(pixels.astype(np.uint8), layout, bits, black, white, notes, colour)
    return Still(pixels, layout, bits, black, white, notes, colour)


def _raw_colour(raw: Any) -> CameraColour | None:
    """Return the matrix that a file states or LibRaw knows, with the white balance as shot."""
    balances = (raw.camera_whitebalance, raw.daylight_whitebalance)
    matrix = _xyz_to_camera(raw)
    for balance in balances:
        with suppress(ValueError):
            return CameraColour.of_raw(matrix, np.asarray(balance, np.float64)[:3])
    return None


def _xyz_to_camera(raw: Any) -> NDArray[np.float64]:
    """Return the matrix from XYZ to the camera's colours; zeros where it is not known.

    Of DNG files of cameras that it does not know, LibRaw tells the inverse alone, for BT.709, and
    apart from it the factors by which rows were divided: one over those of daylight.
    """
    known = np.asarray(raw.rgb_xyz_matrix, np.float64)[:3]
    to_bt709 = np.asarray(raw.color_matrix, np.float64)[:, :3]
    daylight = np.asarray(raw.daylight_whitebalance, np.float64)[:3]
    # Without any matrix it tells the identity.
    if known.any() or np.array_equal(to_bt709, np.eye(3)) or not (daylight > 0).all():
        return known
    with suppress(np.linalg.LinAlgError):
        to_xyz = rgb_to_xyz(BT709_PRIMARIES, D65) @ to_bt709
        return np.asarray(np.linalg.inv(to_xyz) / daylight[:, np.newaxis])
    return known


def _layout(raw: Any, samples: NDArray[np.uint16], name: str) -> tuple[Layout, NDArray[np.intp]]:
    """Return the layout, and the channel numbers of the smallest repeating pattern."""
    if samples.ndim == 3:
        raise _not_read(name, "a raw file with all colours in each pixel")
    if raw.num_colors == 1:
        return Layout.MONO, np.zeros((1, 1), np.intp)
    channels = raw.raw_colors_visible[:2, :2].astype(np.intp)
    names = raw.color_desc.decode("ascii", "replace")
    word = "".join(names[channel] for channel in channels.ravel())
    pattern = raw.raw_pattern
    if word not in _PATTERNS or pattern is None or pattern.shape != (2, 2):
        raise _not_read(name, f"a raw file with the colour filter pattern {word}")
    return _PATTERNS[word], channels


def _raise_blacks(pixels: NDArray[np.uint16], raise_by: NDArray[np.intp], top: int) -> None:
    """Add `raise_by` to the samples of each colour, in place, up to `top`."""
    for row, column in np.ndindex(raise_by.shape):
        part = pixels[row :: raise_by.shape[0], column :: raise_by.shape[1]]
        by = np.uint16(raise_by[row, column])
        np.minimum(part, np.uint16(top - by), out=part)
        part += by
