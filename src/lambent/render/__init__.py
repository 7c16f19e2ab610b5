"""Frames with every feature, from Mitsuba scenes and from Blender's Cycles."""
