"""The page for a laptop, a tablet or a phone: `camctl studio`.

It is a view of the menu's state (`camctl.menu.model.Model`), without logic of its own: what is
chosen in the page becomes keys of the menu.  Its parts are the table `sections.SECTIONS`.
"""
