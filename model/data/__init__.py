"""Training data with the lighting made on the fly."""

from multilight.model.data.dataset import MultiLightDataset, MultiLightStream, Sample
from multilight.model.data.settings import SampleSettings

__all__ = ["MultiLightDataset", "MultiLightStream", "Sample", "SampleSettings"]
