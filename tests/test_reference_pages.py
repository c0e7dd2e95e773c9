"""The pages of findings, of the report's fields and of the options are what the code gives."""

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
SCRIPT = runpy.run_path(str(DOCS / "write_reference.py"))


@pytest.mark.parametrize("page", ["findings", "options", "report"])
def test_a_generated_page_is_up_to_date(page: str) -> None:
    """Update it with: python docs/write_reference.py."""
    text = (DOCS / "reference" / f"{page}.md").read_text(encoding="utf-8")
    assert text == SCRIPT[f"{page}_page"]()
