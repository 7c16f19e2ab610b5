"""What runs inside Blender's Python: no module here imports Lambent.

`server` is the script that the other side starts; it imports this folder as a package of its own.
"""
