"""The command `tailbeat`: its entry point, its options that take lists, its exit codes."""

import errno
import sys
from typing import Any

from tailbeat.cli.renamed import refuse_old_names
from tailbeat.files import EXTRA_OF, BadInput, missing

# Errors of a path that a user gave: too long, no permission, a folder, a full or read-only disk.
OF_PATHS = {
    errno.ENAMETOOLONG, errno.EACCES, errno.EISDIR, errno.ENOTDIR, errno.ENOSPC, errno.EROFS,
    errno.ELOOP,
}  # fmt: skip
INTERRUPTED = 130  # exit code of a verb that Ctrl-C ended
# How a verb continues after Ctrl-C, as its help says.
AGAIN = {
    "identify": "; the same command resumes the search.",
    **dict.fromkeys(("compare", "evaluate", "margins", "zoo"), "; the same command resumes."),
    **dict.fromkeys(("sweep", "train"), "; the same command with --resume continues."),
}

# Options that take several values, with their verbs. Of other verbs, `--servo` is one port.
LISTS = {
    "--fit": "identify",
    "--validate": "identify",
    "--check": "identify predict",
    "--commands": "record",
}
LISTS |= {"--servo": "speed-map", "--tasks": "evaluate", "--only": "compare faults zoo"}
LISTS |= {"--against": "coverage", "--fitted-on": "predict", "--nuisances": "margins"}
LISTS |= {"--log": "refine"}


def spread_lists(arguments: list[str]) -> list[str]:
    """`--fit A B` as `--fit A --fit B`: the parser takes lists only in this form."""
    spread: list[str] = []
    option = None
    for word in arguments:
        if word.startswith("-"):
            option = word if arguments[0] in LISTS.get(word, "").split() else None
        elif option is not None and spread[-1] != option:
            spread.append(option)
        spread.append(word)
    return spread


def run(words: list[str]) -> int:
    """Run the verb that `words` name; returns the exit code. Raises BadInput."""
    refuse_old_names(words)
    if words == ["--version"]:  # without the parser, which takes ten times as long
        from tailbeat import __version__

        print(f"tailbeat {__version__}")
        return 0
    import typer

    from tailbeat.cli.group import tree

    try:
        return tree()(spread_lists(words) or ["--help"], "tailbeat", standalone_mode=False) or 0
    except typer.TyperException as error:
        raise _refusal(error) from None


def _refusal(error: Any) -> BadInput:
    """The parser's error as one sentence."""
    verb = error.ctx.command_path if getattr(error, "ctx", None) else "tailbeat"
    text = " ".join(error.format_message().split()).rstrip(".?")
    return BadInput(f"{text[:1].lower()}{text[1:]}; see {verb} --help.")


def main() -> None:
    """Entry point: bad input is one sentence and exit code 2."""
    try:
        code = run(sys.argv[1:])
        if code == INTERRUPTED:
            _say_interrupted(sys.argv[1:])
    except BadInput as error:
        code = _complain(str(error), 2)
    except ModuleNotFoundError as error:
        if error.name not in EXTRA_OF:
            raise
        code = _complain(f"this verb needs {missing(error.name)}", 2)
    except KeyboardInterrupt:
        code = _say_interrupted(sys.argv[1:])
    except OSError as error:
        if error.errno not in OF_PATHS or not error.filename:
            raise
        code = _complain(f"{error.filename}: {error.strerror}; choose another path.", 2)
    except RecursionError:
        code = _complain("a file is nested too deeply to be read; give one of this package.", 2)
    sys.exit(code)


def _say_interrupted(words: list[str]) -> int:
    verb = words[0] if words else ""
    return _complain(f"interrupted{AGAIN.get(verb, '.')}", INTERRUPTED)


def _complain(text: str, code: int) -> int:
    from tailbeat.cli.output import complain

    complain(text)
    return code
