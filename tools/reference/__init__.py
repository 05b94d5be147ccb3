"""The pages of the site's reference, made from the code that they describe."""

from reference import api, contract, fish, messy, recording, verbs

INDEX = """# Reference

These pages are made from the code when the site is built.

| page | what it lists |
|---|---|
| [Verbs](verbs/index.md) | every verb of the command line, its options and its exit codes |
| [Fish file](fish.md) | every field of a fish, with its unit, default and range |
| [Recording](recording.md) | columns and metadata of a recording |
| [Policy contract](contract.md) | the metadata in `policy.onnx` |
| [Log](log.md) | the topics and fields of a swim's log |
| [Messy pool](messy-pool.md) | every nuisance, with its everyday size and its source |
| [Python](python.md) | every public name of `import tailbeat as tb` |
"""


def pages() -> dict[str, str]:
    """Markdown by path below `reference/`."""
    return {
        "index.md": INDEX,
        **verbs.pages(),
        "fish.md": fish.fish_page(),
        "recording.md": recording.recording_page(),
        "contract.md": contract.contract_page(),
        "log.md": contract.log_page(),
        "messy-pool.md": messy.messy_page(),
        "python.md": api.page(),
    }
