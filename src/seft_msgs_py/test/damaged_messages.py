"""Messages as a link or a foreign program may spoil them."""

from hypothesis import strategies as st

LENGTHS = st.sampled_from([b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x00" * 4, b"\x01\x00\x00\x00"])


def damaged(data, good):
    """Bytes of a good message, cut, longer, or with some of them or a length changed."""
    raw = bytearray(good)
    for at in data.draw(st.lists(st.integers(0, len(raw) - 1), max_size=6), "changed"):
        raw[at : at + 4] = data.draw(st.binary(min_size=1, max_size=4) | LENGTHS, "bytes")
    end = data.draw(st.integers(0, len(raw)) | st.just(len(raw)), "end")
    return bytes(raw[:end]) + data.draw(st.binary(max_size=40), "more")
