"""The gallery of a series: ``index.html``, one static page with a small picture of each set."""

from __future__ import annotations

import html
import math
from pathlib import Path
from urllib.parse import quote

import numpy as np

from camctl.errors import DataError
from camctl.pictures.files import CONTACT, PREVIEW, read_preview
from camctl.records.journal import GALLERY, THUMBNAILS, SeriesJournal, SetRecord
from camctl.system.files import make_folder, storage_error, write_bytes
from camctl.system.library_output import quiet_libraries
from camctl.system.number_text import range_text
from camctl.system.picture_operations import opencv

#: Longest side of a thumbnail, pixels, and the quality of its JPEG file.
_SIDE, _QUALITY = 480, 85

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; --line: #8884; --bad: #c33; }}
body {{ margin: 2rem; font: 15px/1.4 system-ui, sans-serif;
  background: Canvas; color: CanvasText; }}
h1 {{ font-size: 1.4rem; margin: 0; }}
p {{ margin: .3rem 0 1.5rem; opacity: .75; }}
main {{ display: grid; grid-template-columns: repeat(auto-fill, minmax(15rem, 1fr)); gap: 1.2rem; }}
article {{ border: 1px solid var(--line); border-radius: 6px; overflow: hidden; }}
img, .none {{ display: block; width: 100%; aspect-ratio: 4/3; object-fit: contain;
  background: #222; }}
.none {{ display: grid; place-items: center; color: #bbb; }}
h2 {{ font-size: 1rem; margin: .6rem .8rem .2rem; overflow-wrap: anywhere; }}
dl {{ display: grid; grid-template-columns: auto 1fr; gap: 0 .7rem; margin: 0 .8rem .7rem; }}
dt {{ opacity: .65; }}
dd {{ margin: 0; overflow-wrap: anywhere; }}
.bad {{ color: var(--bad); }}
</style>
</head>
<body>
<h1>{title}</h1>
<p>{summary}</p>
<main>
{cards}
</main>
</body>
</html>
"""


def make_thumbnail(directory: Path, record: SetRecord) -> bool:
    """Make the small picture of a complete set; return False where its preview cannot be read.

    It is a JPEG file, which needs OpenCV; without that, False is returned, too.

    Raises:
        StorageError: it could not be written
    """
    if (cv2 := opencv()) is None:
        return False
    try:
        content = read_preview(directory / record.folder)
        with quiet_libraries():
            picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    except (DataError, cv2.error):
        return False
    if picture is None:
        return False
    scale = _SIDE / max(picture.shape[:2])
    if scale < 1:
        size = tuple(max(1, round(side * scale)) for side in picture.shape[1::-1])
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    done, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    if not done:
        return False
    try:
        make_folder(directory / THUMBNAILS)
    except OSError as error:
        raise storage_error(directory / THUMBNAILS, error) from error
    write_bytes(directory / _thumbnail(record), data.tobytes())
    return True


def write_gallery(directory: Path, journal: SeriesJournal) -> None:
    """Write ``index.html``, atomically.  Raises `StorageError`."""
    total, failed = journal.options.repeat, len(journal.failed)
    of = "" if total is None else f" of {total}"
    parts = [f"{journal.completed}{of} sets"]
    if journal.options.interval_s is not None:
        parts.append(f"every {journal.options.interval_s:g} s")
    if failed:
        parts.append(f"{failed} failed")
    if journal.skipped:
        parts.append(f"{journal.skipped} starts left out")
    page = _PAGE.format(
        title=_text(directory.resolve().name),
        summary=_text(", ".join([*parts, journal.camera.name])),
        cards="\n".join(_card(each) for each in journal.sets if each.state != "begun"),
    )
    write_bytes(directory / GALLERY, page.encode("utf-8", "replace"))


def _thumbnail(record: SetRecord) -> str:
    return f"{THUMBNAILS}/{record.number:04d}.jpg"


def _card(record: SetRecord) -> str:
    """Return the part of the page on one set."""
    picture = '<span class="none">no picture</span>'
    if record.has_thumbnail:
        picture = (
            f'<a href="{_link(record.folder)}/{PREVIEW}"><img src="{_thumbnail(record)}" '
            f'alt="{_text(record.folder)}" loading="lazy"></a>'
        )
    rows = [("taken", record.started_at.replace("T", " "), False)]
    if record.response is not None:
        rows += [
            ("response", f"{record.response}, {record.exposures} exposures", False),
            ("range", range_text(record.dynamic_range or math.inf), False),
            (
                "accuracy",
                f"{record.effective_levels:,.3g} effective levels"
                + (" with noise" if record.has_noise else ", noise unknown"),
                False,
            ),
            ("outside", f"{record.outside:.2%} of the samples", False),
        ]
    if not record.trustworthy:
        rows.append(("check", "the frames contradict their exposures", True))
    if record.state == "failed":
        rows.append(("failed", record.error or "", True))
    if record.hook == "failed":
        rows.append(("hook", record.hook_error or "", True))
    listed = "".join(
        f"<dt>{name}</dt><dd{' class=bad' if is_bad else ''}>{_text(value)}</dd>"
        for name, value, is_bad in rows
    )
    link = f'<a href="{_link(record.folder)}/">{_text(record.folder)}</a>'
    if record.state == "complete":
        sheet = f"{_link(record.folder)}/{CONTACT}"
        listed += f'<dt>frames</dt><dd><a href="{sheet}">contact sheet</a></dd>'
    return f"<article>{picture}<h2>{link}</h2><dl>{listed}</dl></article>"


def _text(text: str) -> str:
    """Return text for HTML, in an element or a quoted attribute, without invisible characters."""
    if not text.isprintable():
        text = "".join(each if each.isprintable() else "\N{REPLACEMENT CHARACTER}" for each in text)
    return html.escape(text)


def _link(name: str) -> str:
    """Return a name as one component of a relative link."""
    return "./" + quote(name, safe="", errors="replace")
