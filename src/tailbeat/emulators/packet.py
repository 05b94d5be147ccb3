"""Protocol 2.0 on the servo's side: checksum, status packets, instructions in a stream.

Written independently of the driver's, so that one cannot hide the other's errors.
"""

import struct

SHORTEST = 10  # bytes of a packet: header, id, length, instruction, checksum


def checksum(data: bytes) -> bytes:
    """CRC-16 of protocol 2.0, bit by bit."""
    register = 0
    for byte in data:
        register ^= byte << 8
        for _ in range(8):
            carry = register & 0x8000
            register = (register << 1) & 0xFFFF
            if carry:
                register ^= 0x8005
    return struct.pack("<H", register)


def status(ident: int, error: int, data: bytes) -> bytes:
    """A status packet, stuffed."""
    return _stuffed(ident, bytes([error]) + data)


def fast_status(ident: int, error: int, data: bytes) -> bytes:
    """The status packet of a fast read, which all servos share: each gives error, id and data, and
    the last the packet's checksum."""
    return _stuffed(0xFE, bytes([error, ident]) + data)


def _stuffed(ident: int, content: bytes) -> bytes:
    body, run = bytearray([0x55]), b""
    for byte in content:
        body.append(byte)
        run = (run + bytes([byte]))[-3:]
        if run == b"\xff\xff\xfd":
            body.append(0xFD)
            run = b""
    head = b"\xff\xff\xfd\x00" + struct.pack("<BH", ident, len(body) + 2)
    return head + bytes(body) + checksum(head + bytes(body))


def take(stream: bytearray) -> tuple[int, int, bytes] | None:
    """The next complete instruction (id, instruction, parameters); garbage before it is dropped."""
    while len(stream) >= SHORTEST:
        if stream[:4] != b"\xff\xff\xfd\x00":
            del stream[0]
            continue
        end = 7 + struct.unpack_from("<H", stream, 5)[0]
        if not SHORTEST <= end <= 300:
            del stream[0]
            continue
        if len(stream) < end:
            return None
        whole = bytes(stream[:end])
        del stream[:end]
        if checksum(whole[:-2]) == whole[-2:]:
            body = whole[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
            return whole[4], body[0], body[1:]
    return None
