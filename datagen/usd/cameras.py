"""Cameras as USD has them: apertures and focal length in tenths of a metre."""

from typing import Any

import numpy as np
from pxr import Gf, Sdf, UsdGeom, UsdRender

from multilight.datagen.usd.layout import RENDER, SENSOR, set_own
from multilight.scenes.colour import LUMINOUS_EFFICACY
from multilight.scenes.spec import Camera

NEAR, FAR = 1e-3, 1e5


def add_camera(stage: Any, path: str, camera: Camera) -> None:
    """Write a camera. Its responsivity makes of the lights' luminances the radiance that datasets hold."""
    made = UsdGeom.Camera.Define(stage, path)
    made.AddTransformOp().Set(Gf.Matrix4d(*np.array(camera.c2w).T.ravel().tolist()))
    height = SENSOR * camera.height / camera.width * camera.fx / camera.fy
    focal = camera.fx * SENSOR / camera.width
    made.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    made.CreateHorizontalApertureAttr(SENSOR)
    made.CreateVerticalApertureAttr(height)
    made.CreateHorizontalApertureOffsetAttr((camera.width / 2 - camera.cx) / camera.width * SENSOR)
    made.CreateVerticalApertureOffsetAttr((camera.cy - camera.height / 2) / camera.height * height)
    made.CreateFocalLengthAttr(focal)
    made.CreateClippingRangeAttr(Gf.Vec2f(NEAR, FAR))
    made.CreateFocusDistanceAttr(camera.focus_distance)
    # The f-number is the focal length over the aperture's diameter; 0 stands for a pinhole.
    made.CreateFStopAttr(focal / 10 / (2 * camera.aperture_radius) if camera.aperture_radius > 0 else 0.0)
    made.CreateExposureResponsivityAttr(1 / LUMINOUS_EFFICACY)
    set_own(made.GetPrim(), "resolution", Sdf.ValueTypeNames.Int2, Gf.Vec2i(camera.width, camera.height))


def add_render_settings(stage: Any, path: str, camera: Camera) -> None:
    """Write the picture's size and the first camera as the stage's own render settings."""
    settings = UsdRender.Settings.Define(stage, f"{RENDER}/settings")
    settings.CreateResolutionAttr(Gf.Vec2i(camera.width, camera.height))
    settings.CreatePixelAspectRatioAttr(camera.fy / camera.fx)
    settings.CreateCameraRel().SetTargets([path])
    stage.SetMetadata("renderSettingsPrimPath", f"{RENDER}/settings")
