"""Files that the jobs of a cluster load by name: the same ones on every node."""

import platform
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from tailbeat.control.policy import Policy, contract_digest, load_policy
from tailbeat.files import BadInput

Config = TypeVar("Config", bound=Any)  # frozen data with `fish` and `twin`


def absolute(name: str) -> str:
    """The absolute path of a file, because nodes work in other folders; a shipped name as it is."""
    return str(Path(name).absolute()) if Path(name).is_file() else name


def with_absolute(config: Config) -> Config:
    """A config whose fish and twin are absolute paths, or shipped names."""
    twin = None if config.twin is None else absolute(config.twin)
    made: Config = replace(config, fish=absolute(config.fish), twin=twin)
    return made


def load_same(policy: str, digest: str) -> Policy:
    """Load a policy. Raises BadInput if it is not the one of this digest, which sent the job."""
    loaded = load_policy(policy)
    check_same(policy, contract_digest(loaded.contract), digest)
    return loaded


def check_same(policy: str, digest: str, wanted: str) -> None:
    """Raises BadInput if two digests of a policy differ."""
    if digest != wanted:
        raise BadInput(
            f"{policy}: on {platform.node()} this is another policy than where the command runs;"
            f" give every node the same file."
        )
