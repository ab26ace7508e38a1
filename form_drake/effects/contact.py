"""Effects of contact: tools hold the body in another way than is stated.

How a force is spread over a contact is what the simulation finds: their columns are differences of
simulations.
"""

from dataclasses import replace

from form_drake.effects.effect import Effect

TOOL_FRICTION = Effect(
    id="tool-friction",
    sentence="a tool that is stated to be frictionless rubs",
    unit="-",
    prior=(0.002, 1.5),
    column=None,
    trial=0.1,
    world=lambda scene, size, shape: replace(scene, friction=scene.friction + size),
    shown=("press between plates that do not hold the body",),
    signed=False,
    bends=True,
    faces=("frictionless",),
)

ADHESION = Effect(
    id="adhesion",
    sentence="a tool that is stated to let go sticks",
    unit="Pa",
    prior=(1.0, 1e5),
    column=None,
    trial=200.0,
    world=lambda scene, size, shape: replace(scene, adhesion=scene.adhesion + size),
    shown=("press and lift off",),
    signed=False,
    faces=("frictionless",),
)

FLOOR_SLIP = Effect(
    id="floor-slip",
    sentence="the floor does not hold the body: its foot gives way, or slides where friction holds no more",
    unit="m/Pa",
    prior=(1e-9, 1e-5),
    column=None,
    trial=5e-8,
    world=lambda scene, size, shape: replace(
        scene, slipping=scene.slipping + size, slippery=max(scene.slippery, shape["slippery"])
    ),
    shown=("a push from the side",),
    shapes={"slippery": (0.0, 2.5, 5.0, 9.0)},  # inverse of the friction coefficient
    floors={"slippery": 0.0},
    signed=False,
    faces=("bonded",),
)
