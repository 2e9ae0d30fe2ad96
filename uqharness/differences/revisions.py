"""Aircraft from a revision of a git repository, given as ``REVISION:PATH``.

The repository may be untrusted: its configuration can name programs to run (filters, hooks, a
file-system monitor, remotes for missing objects). Git therefore runs in an empty repository of this
program, which borrows only objects and references of the other one.
"""

from __future__ import annotations

import os
import posixpath
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sysid.foreign.regular_files import in_words, read_regular
from uqharness.errors import BadInputError
from uqharness.simulator import Aircraft, find_aircraft

MAX_FILES = 5_000
MAX_BYTES = 64_000_000
"""Largest number of files of an aircraft and of bytes in them; JSBSim's largest has 2 MB."""
_LISTING_BYTES = 4_000_000
_REFERENCE_BYTES = 64_000_000
_MEMORY_BYTES = 2_000_000_000
_TIMEOUT_S = 60.0
_MESSAGE_CHARACTERS = 200
"""Characters of the user's text that a message repeats."""
_FILE_MODES = (b"100644", b"100755")
_EXAMPLE = "give REVISION:FOLDER, such as HEAD~1:aircraft/espaaro"


def split_revision(text: str) -> tuple[str, str] | None:
    """Split ``REVISION:PATH``; None for a name, an existing path, or a drive letter."""
    revision, colon, path = text.partition(":")
    if not colon or len(revision) < 2 or not path or _exists(text):
        return None
    return revision, path


def aircraft_at(text: str, scratch: Path) -> Aircraft:
    """Return an aircraft by name, folder or ``REVISION:PATH``.

    Parameters
    ----------
    text : str
        Name, folder, or revision and path.
    scratch : Path
        Folder into which the files of a revision are unpacked.

    Raises
    ------
    BadInputError
        If there is no such aircraft, revision or repository, or git fails.
    """
    revision_and_path = split_revision(text)
    if revision_and_path is None:
        return find_aircraft(text)
    revision, path = revision_and_path
    requested = text if len(text) <= _MESSAGE_CHARACTERS else f"{text[:_MESSAGE_CHARACTERS]}..."
    try:
        repository = _find_repository(Path.cwd())
        if repository is None:
            raise BadInputError(f"{requested}: {Path.cwd()} is in no git repository; {_EXAMPLE}")
        inner_path = _path_within(path, repository.top)
        if inner_path is None:
            raise BadInputError(
                f"{requested}: this path is outside the repository {repository.top}; {_EXAMPLE}"
            )
        scratch.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="git-", dir=scratch) as name:
            reader = _Reader(repository, Path(name), requested)
            files = reader.files(reader.commit(revision), inner_path)
            _write(files, scratch)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise BadInputError(
            f"{requested}: cannot be read: {' '.join(str(reason).split())}; {_EXAMPLE}"
        ) from None
    return find_aircraft(scratch / inner_path)


@dataclass(frozen=True)
class _Repository:
    """Folders of a repository.

    Attributes
    ----------
    top : Path
        Working folder.
    folder : Path
        Its ``.git`` folder.
    common : Path
        Folder of objects and references; another one for a worktree.
    """

    top: Path
    folder: Path
    common: Path


def _find_repository(start: Path) -> _Repository | None:
    """Find the repository that contains a folder; None outside any.

    Git itself is not asked, because it would read the repository's configuration.
    """
    for top in (start, *start.parents):
        place = top / ".git"
        if place.is_file():  # of a worktree or a submodule
            words = read_regular(place, 10_000).decode().strip()
            place = top / words.removeprefix("gitdir:").strip()
        if not (place / "HEAD").exists():
            continue
        common = place
        if (place / "commondir").is_file():
            common = place / read_regular(place / "commondir", 10_000).decode().strip()
        return _Repository(top, place, common)
    return None


def _path_within(path: str, top: Path) -> str | None:
    """Return a path as git writes it below ``top``; None outside it and for ``top`` itself."""
    # Relative paths count from the working folder.
    full = posixpath.normpath(posixpath.join(Path.cwd().as_posix(), path))
    inside = posixpath.relpath(full, top.as_posix())
    return None if "\0" in path or inside == "." or inside.split("/")[0] == ".." else inside


class _Reader:
    """Git in an empty repository that borrows objects and references of another one."""

    def __init__(self, repository: _Repository, place: Path, requested: str) -> None:
        self._place, self._requested = place, requested
        objects = repository.common / "objects"
        # Alternates could point anywhere.
        if (objects / "info" / "alternates").exists():
            raise BadInputError(
                f"{requested}: the repository keeps objects elsewhere (objects/info/alternates),"
                " and these are not read; make a full clone of it and run there"
            )
        for name in ("objects", "refs"):
            (place / name).mkdir()
        (place / "config").write_text(_config(repository.common), encoding="utf-8")
        remaining = _REFERENCE_BYTES
        # Worktrees have separate references.
        for source in (repository.common, repository.folder):
            for name in ("packed-refs", "HEAD", "refs", "logs"):
                remaining = _copy_references(source / name, place / name, remaining)
        self._environment = {
            key: value for key, value in os.environ.items() if not key.startswith("GIT_")
        } | {
            "GIT_DIR": str(place),
            "GIT_OBJECT_DIRECTORY": str(objects.absolute()),
            "GIT_CONFIG_NOSYSTEM": "1",
            "GIT_CONFIG_GLOBAL": os.devnull,
            "GIT_NO_REPLACE_OBJECTS": "1",
            "GIT_NO_LAZY_FETCH": "1",
            "GIT_ALLOW_PROTOCOL": "none",
            "GIT_LITERAL_PATHSPECS": "1",
            "GIT_TERMINAL_PROMPT": "0",
            "LC_ALL": "C",
        }

    def commit(self, revision: str) -> str:
        """Return the hash of the commit that a revision names."""
        # --end-of-options keeps a revision from being read as an option.
        words = ["rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}"]
        name = self._run(words, 1000).decode("ascii", "replace").strip()
        if not name or not set(name) <= set("0123456789abcdef"):
            raise BadInputError(
                f"{self._requested}: the repository has no revision"
                f" {revision[:_MESSAGE_CHARACTERS]!r}; {_EXAMPLE}"
            )
        return name

    def files(self, commit: str, folder: str) -> dict[str, bytes]:
        """Return path and content of every regular file below a folder of a commit.

        Number and size are checked before any content is read.
        """
        listing = self._run(["ls-tree", "-r", "-l", "-z", commit, "--", folder], _LISTING_BYTES)
        sizes: dict[str, tuple[str, int]] = {}
        for line in filter(None, listing.split(b"\0")):
            facts, _, name = line.partition(b"\t")
            # Columns of ls-tree -l: mode, type, object, size.
            mode, kind, blob, size = facts.split()
            path = os.fsdecode(name)
            # Links lead out of the folder, and submodules are in another repository.
            if mode in _FILE_MODES and kind == b"blob" and path.startswith(f"{folder}/"):
                if not _is_plain(path):
                    raise BadInputError(
                        f"{self._requested}: holds a file named {path!r}, which cannot be unpacked"
                    )
                sizes[path] = (blob.decode(), int(size))
        total = sum(size for _, size in sizes.values())
        if not sizes:
            raise BadInputError(
                f"{self._requested}: the revision has no folder {folder[:_MESSAGE_CHARACTERS]} with"
                f" files; {_EXAMPLE}"
            )
        if len(sizes) > MAX_FILES or total > MAX_BYTES:
            raise BadInputError(
                f"{self._requested}: has {len(sizes)} files of {in_words(total)} together; an"
                f" aircraft may have {MAX_FILES} of {in_words(MAX_BYTES)}"
            )
        names = "".join(f"{blob}\n" for blob, _ in sizes.values())
        limit = total + 200 * len(sizes)
        # One process reads all files; each is preceded by a header line and followed by a line end.
        content = self._run(["cat-file", "--batch"], limit, names.encode())
        files: dict[str, bytes] = {}
        position = 0
        for path, (_, length) in sizes.items():
            begin = content.index(b"\n", position) + 1
            files[path] = content[begin : begin + length]
            position = begin + length + 1
        return files

    def _run(self, words: Sequence[str], max_bytes: int, stdin: bytes = b"") -> bytes:
        """Run a git command and return its output.

        Raises BadInputError if it fails, prints more than ``max_bytes``, or takes too long.
        """
        output = self._place / "output"
        try:
            with output.open("wb") as handle:
                process = subprocess.run(
                    ["git", *words],
                    cwd=self._place,
                    env=self._environment,
                    input=stdin,
                    stdout=handle,
                    stderr=subprocess.PIPE,
                    check=False,
                    timeout=_TIMEOUT_S,
                    # POSIX only: limits that the child sets for itself.
                    preexec_fn=None if os.name == "nt" else _limits(max_bytes),
                )
        except FileNotFoundError:
            raise BadInputError(
                f"{self._requested}: a revision needs git, which is not installed"
            ) from None
        except subprocess.TimeoutExpired:
            raise BadInputError(
                f"{self._requested}: git {words[0]} took more than {_TIMEOUT_S:g} s; the repository"
                " is damaged or made to hold it up"
            ) from None
        if process.returncode and words[0] != "rev-parse":
            lines = process.stderr.decode(errors="replace").strip().splitlines()
            reason = (
                " ".join(lines[-1].split())
                if lines
                else "stopped at the limit of memory or of output"
            )
            raise BadInputError(f"{self._requested}: git {words[0]}: {reason[:300]}; {_EXAMPLE}")
        return read_regular(output, max_bytes + 1)


def _limits(max_bytes: int) -> Callable[[], None]:
    """Return a function that limits memory and output of the child before git starts."""

    def limit() -> None:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes + 1, max_bytes + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    return limit


def _config(common: Path) -> str:
    """Return the configuration of the empty repository.

    Only the hash algorithm is taken from the other repository's configuration.
    """
    sha256 = False
    path = common / "config"
    if path.is_file():
        text = read_regular(path, 1_000_000).decode("utf-8", "replace").lower()
        sha256 = any(
            line.replace(" ", "").replace("\t", "") == "objectformat=sha256"
            for line in text.splitlines()
        )
    version = "[core]\nrepositoryformatversion = 1\nbare = true\nfsmonitor = false\n"
    # Packs are mapped in pieces, so that large ones keep within the limit of memory.
    version += "packedGitWindowSize = 32m\npackedGitLimit = 256m\nbigFileThreshold = 16m\n"
    return version + ("[extensions]\nobjectformat = sha256\n" if sha256 else "")


def _copy_references(source: Path, target: Path, remaining: int) -> int:
    """Copy references without links; return the bytes that may still be copied."""
    if source.is_symlink():
        return remaining
    if source.is_dir():
        target.mkdir(exist_ok=True)
        for item in sorted(os.listdir(source)):
            remaining = _copy_references(source / item, target / item, remaining)
    elif source.is_file():
        content = read_regular(source, remaining)
        target.write_bytes(content)
        # Each file counts at least 100 bytes, so that many empty files end the copy too.
        remaining -= len(content) + 100
        if remaining <= 0:
            raise ValueError(
                f"the repository's references take more than {in_words(_REFERENCE_BYTES)}"
            )
    return remaining


def _is_plain(path: str) -> bool:
    """Return whether a path has no part that leads elsewhere on any system."""
    parts = path.split("/")
    return not any(part in ("", ".", "..") or "\\" in part or ":" in part for part in parts)


def _write(files: dict[str, bytes], folder: Path) -> None:
    """Write files below a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def _exists(text: str) -> bool:
    """Return whether a path exists; False for text that is no path."""
    try:
        return Path(text).exists()
    except (OSError, ValueError):
        return False
