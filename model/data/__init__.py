"""Training data with the lighting made on the fly."""

from model.data.dataset import MultiLightDataset, MultiLightStream, Sample
from model.data.settings import SampleSettings

__all__ = ["MultiLightDataset", "MultiLightStream", "Sample", "SampleSettings"]
