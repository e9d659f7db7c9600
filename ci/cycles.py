#!/usr/bin/env python3
"""Lists import cycles between the source files of crates: ci/cycles.py [SRC].. (default: all crates)

A file imports another one if a path in it (`crate::`, `super::`, `self::`, in `use` items or elsewhere) leads to an item
of the other file. Re-exports are followed to the file that defines the item. `#[cfg(test)] mod tests` and files named
tests.rs are ignored. Paths to items of the crate root itself are ignored, too. Prints each group of files that import
each other, largest first, and exits with 1 if there is any.
"""

import re
import sys
from pathlib import Path

PUBLIC_USE = re.compile(r"\bpub(?:\([^)]*\))?\s+use\s+([^;]+);")
ANY_USE = re.compile(r"\buse\s+([^;]+);")
INLINE_PATH = re.compile(r"\b((?:crate|super|self)(?:::\w+)+)")


def code_of(path):
    """Returns the text of a file without comments, strings and unit tests."""
    text = re.sub(r"/\*.*?\*/", "", path.read_text(), flags=re.S)
    text = re.sub(r"//[^\n]*", "", text)
    text = re.sub(r"\bpub\(in [^)]*\)", "pub", text)  # a visibility imports nothing
    text = re.sub(r'"(?:\\.|[^"\\])*"', '""', text, flags=re.S)
    tests = re.search(r"#\[cfg\(test\)\]\s*mod tests\b", text)
    return text[: tests.start()] if tests else text


def split_tree(text):
    """Splits the body of a use group at its top-level commas."""
    parts, depth = [""], 0
    for char in text:
        depth += (char == "{") - (char == "}")
        if char == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += char
    return [part.strip() for part in parts if part.strip()]


def paths_of(tree):
    """Expands a use tree into paths: `a::{b, c::d as e}` into [[a, b], [a, c, d]]."""
    head, brace, body = tree.strip().partition("{")
    names = [name.strip() for name in re.split(r"\s+as\s+", head)[0].split("::") if name.strip()]
    if not brace:
        return [names]
    return [names + rest for part in split_tree(body[: body.rindex("}")]) for rest in paths_of(part)]


class Crate:
    """Modules of a crate by their path, such as ("raster", "compute", "plan"), and their imports."""

    def __init__(self, src):
        self.code = {}
        for path in sorted(src.rglob("*.rs")):
            if path.stem != "tests" and path.name != "main.rs":
                parts = path.relative_to(src).with_suffix("").parts
                self.code[parts[:-1] if parts[-1] in ("mod", "lib") else parts] = code_of(path)
        self.reexports = {
            module: {path[-1]: path for tree in PUBLIC_USE.findall(code) for path in paths_of(tree)}
            for module, code in self.code.items()
        }
        self.imports = {module: self.imports_of(module) for module in self.code}

    def absolute(self, module, path):
        """Resolves the first names of a path; `None` for a path into another crate."""
        if path[0] == "crate":
            return tuple(path[1:])
        if path[0] not in ("self", "super"):
            return module + tuple(path) if module + (path[0],) in self.code else None
        if path[0] == "self":
            path = path[1:]
        while path and path[0] == "super":
            module, path = module[:-1], path[1:]
        return module + tuple(path)

    def file_of(self, path, followed=()):
        """Returns the module of the file that defines the item at an absolute path."""
        length = next(n for n in range(len(path), -1, -1) if path[:n] in self.code)
        module, rest = path[:length], path[length:]
        if rest and rest[0] in self.reexports[module] and (module, rest[0]) not in followed:
            target = self.absolute(module, self.reexports[module][rest[0]])
            if target is not None:
                return self.file_of(target, followed + ((module, rest[0]),))
        return module

    def imports_of(self, module):
        private = PUBLIC_USE.sub("", self.code[module])
        paths = [path for tree in ANY_USE.findall(private) for path in paths_of(tree)]
        paths += [path.split("::") for path in INLINE_PATH.findall(ANY_USE.sub("", private))]
        targets = (self.absolute(module, path) for path in paths)
        return {self.file_of(target) for target in targets if target is not None} - {module, ()}

    def reachable(self, module):
        found, todo = set(), [module]
        while todo:
            new = self.imports[todo.pop()] - found
            found |= new
            todo += new
        return found

    def cycles(self):
        """Returns the groups of modules that reach each other, largest first."""
        reach = {module: self.reachable(module) for module in self.imports}
        groups = {
            tuple(sorted(other for other in reach[module] if module in reach[other]))
            for module in reach
            if module in reach[module]
        }
        return sorted(groups, key=lambda group: (-len(group), group))


def main():
    found = 0
    root = Path(__file__).resolve().parent.parent
    for src in sys.argv[1:] or [root / "src", *sorted(root.glob("crates/*/src"))]:
        crate = Crate(Path(src))
        cycles = crate.cycles()
        for group in cycles:
            print(f"{len(group)} files: " + " ".join("/".join(module) for module in group))
        print(f"{src}: {len(crate.code)} files, {len(cycles)} cycles, {sum(map(len, cycles))} files in them")
        found += len(cycles)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
