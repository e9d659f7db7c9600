"""Registry of the messages of this package, apart from the default one of protobuf."""

from google.protobuf.descriptor_pool import DescriptorPool

POOL = DescriptorPool()
