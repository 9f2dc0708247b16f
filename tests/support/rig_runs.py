"""Runs of a rig by flat keywords: those of its settings, of its hooks and of what is known."""

from dataclasses import fields

from masking.lab.plants.interface import Settings
from masking.lab.runs import realtime


def run_rig(step, plant, *, samples, limits, **chosen):
    """`masking.lab.runs.realtime.run_rig`, with the fields of `Settings` and `Hooks` as keywords."""
    settings = {field.name: chosen.pop(field.name) for field in fields(Settings) if field.name in chosen}
    hooks = realtime.Hooks(**chosen)
    return realtime.run_rig(step, plant, Settings(**settings), samples=samples, limits=limits, hooks=hooks)
