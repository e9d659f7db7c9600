#!/usr/bin/env python3
"""Checks README, CONTRIBUTING and the book in docs: ci/book.py

Every page of docs is in SUMMARY.md, and every relative link leads to an existing file and heading. Builds the book into
a temporary folder if mdbook is installed. Prints the number of pages and links; exits with 1 and a list of errors."""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LINK = re.compile(r"(?<!\\)\[[^\]]*\]\(([^)\s]+)\)")


def text_of(path):
    """Returns the text of a page without code blocks and code."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```", "", path.read_text(), flags=re.S | re.M))


def anchors(path):
    """Returns the anchors of a page's headings, as GitHub and mdBook name them."""
    headings = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```", "", path.read_text(), flags=re.S | re.M), flags=re.M)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.strip().replace(" ", "-") for heading in plain}


def main():
    docs = ROOT / "docs"
    pages = sorted(path for path in docs.rglob("*.md"))
    listed = {(docs / target).resolve() for target in LINK.findall(text_of(docs / "SUMMARY.md"))}
    errors = [f"{page.relative_to(ROOT)}: not in SUMMARY.md" for page in pages if page.resolve() not in listed | {docs / "SUMMARY.md"}]
    links = 0
    for page in [*ROOT.glob("*.md"), *pages]:
        for link in LINK.findall(text_of(page)):
            if re.match(r"[a-z]+:", link):
                continue
            links += 1
            name, _, anchor = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            if not target.exists():
                errors.append(f"{page.relative_to(ROOT)}: no file {link}")
            elif anchor and target.suffix == ".md" and anchor not in anchors(target):
                errors.append(f"{page.relative_to(ROOT)}: no heading {link}")
    if shutil.which("mdbook"):
        with tempfile.TemporaryDirectory() as out:
            built = subprocess.run(["mdbook", "build", str(docs), "--dest-dir", out], capture_output=True, text=True)
            errors += [built.stderr.strip()] if built.returncode else []
    print(*errors, sep="\n", end="\n" if errors else "")
    print(f"book: {len(pages)} pages, {links} links, {len(errors)} errors")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
