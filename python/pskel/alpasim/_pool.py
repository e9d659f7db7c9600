"""Registry for this package's messages, separate from protobuf's default registry."""

from google.protobuf.descriptor_pool import DescriptorPool

POOL = DescriptorPool()
