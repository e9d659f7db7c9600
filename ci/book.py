#!/usr/bin/env python3
"""Checks the book in docs, and the links of README, CONTRIBUTING and the like: ci/book.py

Every page is in SUMMARY.md, every entry of SUMMARY.md exists, and every relative link leads to an existing file and
heading. Builds the book into a temporary folder if mdbook is installed. Prints the number of pages and links; exits with 1
and a list of errors otherwise."""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BOOK = ROOT / "docs"
LINK = re.compile(r"\]\(([^)\s]+)\)")


def text_of(path):
    """Returns the text of a page without code blocks."""
    return re.sub(r"^ *```.*?^ *```", "", path.read_text(), flags=re.S | re.M)


def anchors(path):
    """Returns the anchors of a page's headings, as GitHub and mdBook name them."""
    headings = re.findall(r"^#+ (.*)$", text_of(path), flags=re.M)
    return {re.sub(r"[^\w\- ]", "", re.sub(r"\]\(.*?\)", "", heading).lower()).replace(" ", "-") for heading in headings}


def main():
    summary = BOOK / "src/SUMMARY.md"
    pages = sorted(set(BOOK.rglob("*.md")) - {summary})
    listed = {(summary.parent / target).resolve() for target in LINK.findall(text_of(summary))}
    errors = [f"{page.relative_to(ROOT)}: not in SUMMARY.md" for page in pages if page not in listed]
    links = 0
    for page in [*sorted(ROOT.glob("*.md")), summary, *pages]:
        for link in LINK.findall(re.sub(r"`[^`\n]*`", "", text_of(page))):
            if re.match(r"[a-z]+:", link):
                continue
            links += 1
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            if not target.exists():
                errors.append(f"{page.relative_to(ROOT)}: no file {link}")
            elif anchor and anchor not in anchors(target):
                errors.append(f"{page.relative_to(ROOT)}: no heading {link}")
    if shutil.which("mdbook"):
        with tempfile.TemporaryDirectory() as out:
            built = subprocess.run(["mdbook", "build", str(BOOK), "--dest-dir", out], capture_output=True, text=True)
            errors += [built.stderr.strip()] if built.returncode else []
    print(*errors, f"book: {len(pages)} pages, {links} links", sep="\n")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
