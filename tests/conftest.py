"""Settings of all Python tests."""

from hypothesis import settings

# No deadline: the machine may be busy. The same examples every time: a result can be repeated.
settings.register_profile("omnislip", deadline=None, derandomize=True)
settings.load_profile("omnislip")
