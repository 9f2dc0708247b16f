"""What a new user asks for: each system on the ideal rig and on the imperfect twin, beside a controller by hand."""

import pytest

from tests.benchmarks.wishes import WISHES, largest

# With two samples of delay; the example has one. Friction is the cause, and chi grows along the beat.
WORSE = {"two_carts": 0.08}


@pytest.mark.parametrize("wish", WISHES.values(), ids=lambda wish: wish.text)
def test_each_wish_is_masked(wish):
    assert wish.on_ideal(wish.short) < 1e-6
    run = wish.run(wish.short)
    assert largest(run) < WORSE.get(wish.name, 0.03)
    assert largest(run) < 0.5 * wish.by_hand(run)
