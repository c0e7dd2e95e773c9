"""Cameras of camctl in the interfaces of other projects; each module needs the extra of its name.

They use what `camctl` makes public, and small tools of `camctl.system`.
"""
