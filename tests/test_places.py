"""The pool, places in it and network addresses, as a person types them."""

import math

import pytest

from tailbeat.files import BadInput
from tailbeat.link.addresses import address
from tailbeat.link.places import (
    ANY_POOL,
    POOL,
    TARGET,
    as_text,
    is_pool,
    place,
    pool_size,
    room,
    within,
)


def test_the_paper_s_pool_holds_the_default_target():
    assert POOL == (5.5, 2.7) and is_pool(*POOL)
    assert place(within(TARGET, POOL)) == (1.5, 0.5)
    assert place(within(TARGET, room(0.4)), pool=room(0.4)) == pytest.approx((0.6, 0.2))
    assert pool_size(as_text(room(0.631))) == pytest.approx((3.4705, 1.7037))


@pytest.mark.parametrize("text", ["2.75,1.35", "-2.75,-1.35", " 0 , 0"])
def test_a_place_may_lie_at_the_wall(text):
    assert place(text) == tuple(map(float, text.split(",")))


@pytest.mark.parametrize("text", ["2.76,0", "-2.76,0", "0,1.36", "0,-1.36", "nan,0", "0,nan"])
def test_a_place_beyond_the_wall_is_refused_with_the_ends_it_may_have(text):
    with pytest.raises(BadInput, match=r"--target .*: outside .* to 2\.75 m, y .* to 1\.35 m"):
        place(text)


def test_a_place_is_held_against_the_pool_that_is_given():
    assert place("4.9,-1.9", pool=(10.0, 4.0)) == (4.9, -1.9)
    with pytest.raises(BadInput, match=r"--to 4\.9,-1\.9: .* to 4 m, y .* to 3 m"):
        place("4.9,-1.9", "--to", (8.0, 6.0))


def test_while_the_pool_is_not_known_a_place_may_lie_in_the_largest():
    assert place("4,-3", pool=ANY_POOL) == (4.0, -3.0)
    for text in ("50.1,0", "0,nan", "inf,0"):
        with pytest.raises(BadInput, match=r"outside the pool: .* to 50 m, y .* to 50 m"):
            place(text, pool=ANY_POOL)


@pytest.mark.parametrize("text", ["1", "1,2,3", "a,b", ""])
def test_two_numbers_make_a_place_and_a_pool(text):
    with pytest.raises(BadInput, match=f"--target '{text}': give x,y in metres"):
        place(text)
    with pytest.raises(BadInput, match=f"--pool '{text}': give length,width in metres"):
        pool_size(text)


def test_a_pool_s_sides_may_be_30_cm_to_100_m():
    assert pool_size("0.3,100") == (0.3, 100.0) and pool_size("100,0.3") == (100.0, 0.3)
    for sides in (
        (0.29, 1.0),
        (1.0, 0.29),
        (100.1, 1.0),
        (1.0, 100.1),
        (-1.0, 1.0),
        (1.0, math.inf),
    ):
        assert not is_pool(*sides)
        with pytest.raises(BadInput, match=r"each side must be 0\.3 to 100 m"):
            pool_size("{},{}".format(*sides))


@pytest.mark.parametrize("text", ["127.0.0.1", ":5151", "127.0.0.1:x", "127.0.0.1:65536"])
def test_an_address_needs_host_and_port(text):
    with pytest.raises(BadInput, match="give host:port"):
        address(text, "--listen")


def test_an_address_is_looked_up_once():
    assert address("localhost:0", "--listen") == ("127.0.0.1", 0)
    assert address("127.0.0.1:65535", "--listen") == ("127.0.0.1", 65535)
    with pytest.raises(BadInput, match=r"nobody\.invalid"):
        address("nobody.invalid:5151", "--station")
