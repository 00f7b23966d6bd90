"""Dense optical flow from a frame to the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from spinestiff.imaging.tracking.pictures import Image


def dense_flow(image: NDArray[np.uint8], following: NDArray[np.uint8]) -> Image:
    """Dense optical flow (H, W, 2), pixels, from an image to the one that follows."""
    import cv2

    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    # The third argument is the flow to start from, not only where to write.
    return np.asarray(flow.calc(image, following, np.zeros((*image.shape, 2), np.float32)))
