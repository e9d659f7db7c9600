"""Networks for the denoising loop; each is a subpackage with requirements of its own."""
