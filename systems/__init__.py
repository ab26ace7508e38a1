"""Drake and devices: LeafSystems, drivers and the diagrams that hold them.

This room is the only one that imports pydrake, and later the only one that talks to cameras and
robots. It contains no mathematics: a ``Calc`` unpacks its ports, calls one function of the rooms
below, and packs the answer. A station has the same ports in simulation and on hardware.
"""
