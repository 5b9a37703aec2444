"""What sign it is: the class of its face by the pixels, and its code by all that was measured."""

from wayside.stages.sign_codes.codes import OTHER_SHARE, assign_codes
from wayside.stages.sign_codes.face_classes import (
    CLASSES,
    FACE_OUTPUT,
    FACES,
    OTHER_FACE,
    PATCH_SIDE,
    FaceClassifier,
    classify_faces,
    face_patch,
    face_samples,
)

__all__ = [
    "CLASSES",
    "FACES",
    "FACE_OUTPUT",
    "OTHER_FACE",
    "OTHER_SHARE",
    "PATCH_SIDE",
    "FaceClassifier",
    "assign_codes",
    "classify_faces",
    "face_patch",
    "face_samples",
]
