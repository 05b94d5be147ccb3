"""Parse network addresses that a person types."""

import socket

from tailbeat.files import BadInput


def address(text: str, option: str) -> tuple[str, int]:
    """Parse `host:port` and resolve the host once. Raises BadInput; `option` names the text in its
    message."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 <= int(port) < 65536:
        raise BadInput(f"{option} {text!r}: give host:port, like 127.0.0.1:5151.")
    try:
        return socket.gethostbyname(host), int(port)  # once, not in every period of the loop
    except (OSError, UnicodeError) as error:  # the second for names that no host may have
        said = getattr(error, "strerror", None) or "no name of a host"
        raise BadInput(f"{option} {host}: {said}; give its numeric address.") from None
