"""A result in the form of a paper: a paragraph, a table, references, and what is left to its authors."""

from .document import Document, methods_document
from .facts import ArmFacts, arm_facts
from .markup import MARKUPS, rendered

__all__ = ["MARKUPS", "ArmFacts", "Document", "arm_facts", "methods_document", "rendered"]
