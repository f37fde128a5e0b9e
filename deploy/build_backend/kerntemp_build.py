"""Build the wheel as setuptools does. (The page's chart library is fetched here.)"""

from setuptools.build_meta import *  # noqa: F403
