# SPDX-License-Identifier: GPL-3.0-or-later
"""HTML pages of the benchmark, the reproduction tables and the test reports: Jinja2 templates with one style, and embedded images."""
