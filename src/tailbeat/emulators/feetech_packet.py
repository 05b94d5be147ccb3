"""FT-SCS on the servo's side: answers, and instructions in a stream.

Written independently of the driver's, so that one cannot hide the other's errors.
"""


def checksum(body: bytes) -> int:
    """The last byte of a packet: the bytes from the id on add up to 255 with it, modulo 256."""
    total = 0
    for byte in body:
        total = (total + byte) % 256
    return 255 - total


def status(ident: int, errors: int, data: bytes = b"") -> bytes:
    """An answer: the servo's error bits, then data."""
    body = bytes([ident, len(data) + 2, errors, *data])
    return b"\xff\xff" + body + bytes([checksum(body)])


def take(stream: bytearray) -> tuple[int, int, bytes] | None:
    """The next complete instruction (id, instruction, parameters); garbage before it is dropped."""
    while len(stream) >= 6:
        ident, length = stream[2], stream[3]
        if stream[:2] != b"\xff\xff" or ident == 0xFF or not 2 <= length <= 250:
            del stream[0]
            continue
        if len(stream) < length + 4:
            return None
        whole = bytes(stream[: length + 4])
        if checksum(whole[2:-1]) != whole[-1]:
            del stream[0]
            continue
        del stream[: length + 4]
        return ident, whole[4], whole[5:-1]
    return None
