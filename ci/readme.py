#!/usr/bin/env python3
"""Checks that README.md and the front page of the crate's documentation (src/lib.rs) agree: ci/readme.py

The Rust example is the same in both, and the table of features lists the features of Cargo.toml. Prints one line; exits
with 1 and the differences otherwise."""

import difflib
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def example(text):
    """Returns the lines of the first Rust block of a page."""
    return re.search(r"^```(?:rust,)?no_run\n(.*?)^```", text, flags=re.S | re.M).group(1).splitlines()


def main():
    head = re.match(r"(?://!.*\n)+", (ROOT / "src/lib.rs").read_text()).group(0)
    page = re.sub(r"^//! ?", "", head, flags=re.M)
    readme = (ROOT / "README.md").read_text()
    errors = list(difflib.unified_diff(example(readme), example(page), "README.md", "src/lib.rs", lineterm=""))
    features = re.search(r"^\[features\]\n(.*?)\n\n", (ROOT / "Cargo.toml").read_text(), flags=re.S | re.M).group(1)
    declared = set(re.findall(r'^"?(\w+)"? = ', features, flags=re.M)) - {"default"}
    listed = set(re.findall(r"^\| `(\w+)` \|", page, flags=re.M))
    errors += [f"src/lib.rs: expected the features {sorted(declared)}, found {sorted(listed)}"] if declared != listed else []
    lines = readme.count("\n")
    errors += [f"README.md: expected at most 90 lines, found {lines}"] if lines > 90 else []
    print(*errors, sep="\n", end="\n" if errors else "")
    print(f"readme: {lines} lines, example of {len(example(readme))} lines, {len(listed)} features, {'differs' if errors else 'agrees'}")
    return 1 if errors else 0


if __name__ == "__main__":
    sys.exit(main())
