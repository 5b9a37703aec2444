"""The meaning of a sign: the class of its face by the pixels, and its code by all measurements."""

from wayside.stages.sign_codes.codes import OTHER_SHARE as OTHER_SHARE
from wayside.stages.sign_codes.codes import assign_codes as assign_codes
from wayside.stages.sign_codes.face_classes import CLASSES as CLASSES
from wayside.stages.sign_codes.face_classes import FACE_OUTPUT as FACE_OUTPUT
from wayside.stages.sign_codes.face_classes import FACES as FACES
from wayside.stages.sign_codes.face_classes import OTHER_FACE as OTHER_FACE
from wayside.stages.sign_codes.face_classes import PATCH_SIDE as PATCH_SIDE
from wayside.stages.sign_codes.face_classes import FaceClassifier as FaceClassifier
from wayside.stages.sign_codes.face_classes import classify_faces as classify_faces
from wayside.stages.sign_codes.face_classes import face_patch as face_patch
from wayside.stages.sign_codes.face_classes import face_samples as face_samples
