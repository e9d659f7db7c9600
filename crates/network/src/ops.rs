//! The kernels as differentiable operations of the tensor library.

use candle_core::{
    CpuStorage, CustomOp1, CustomOp2, CustomOp3, Device, Layout, Result, Shape, Storage, Tensor, bail,
};

use super::kernels::{self, AttentionMlp, Convolution, Resize};

/// Returns the values of a contiguous tensor.
fn slice<'a>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [f32]> {
    let Some((begin, end)) = layout.contiguous_offsets() else { bail!("expected a contiguous tensor") };
    Ok(&storage.as_slice::<f32>()?[begin..end])
}

/// Calls `f` with the values of tensors.
fn lend<R>(tensors: &[&Tensor], f: impl FnOnce(&[&[f32]]) -> R) -> Result<R> {
    let tensors = tensors.iter().map(|tensor| tensor.contiguous()).collect::<Result<Vec<_>>>()?;
    let guards: Vec<_> = tensors.iter().map(Tensor::storage_and_layout).collect();
    let mut slices = Vec::with_capacity(guards.len());
    for (storage, layout) in &guards {
        let Storage::Cpu(storage) = &**storage else { bail!("expected a tensor of the CPU") };
        slices.push(slice(storage, layout)?);
    }
    Ok(f(&slices))
}

fn like(tensor: &Tensor, values: Vec<f32>) -> Result<Tensor> {
    Tensor::from_vec(values, tensor.shape(), &Device::Cpu)
}

/// Returns `[attention, gelu(hidden)] [R, d + m]` of rows `[q, k, v, hidden] [R, 3d + m]`.
pub(super) fn mix(rows: &Tensor, shape: AttentionMlp) -> Result<Tensor> {
    rows.apply_op1(MixOp(shape))
}

/// Returns `norm(x) (1 + scale) + shift`; `x [R, d]`, `modulation [G, 2d]` of `(shift, scale)`; each row
/// applies to `R / G` rows.
pub(super) fn norm_modulate(x: &Tensor, modulation: &Tensor) -> Result<Tensor> {
    x.apply_op2(modulation, NormOp)
}

/// Returns `x + gate y`; `x, y [R, d]`, `gate [G, d]`.
pub(super) fn gated_add(x: &Tensor, y: &Tensor, gate: &Tensor) -> Result<Tensor> {
    x.apply_op3(y, gate, GateOp)
}

/// Returns the convolution of images; `x [N H W, C]`, `weights [9 C, D]`, `bias [D]`.
pub(super) fn convolve(x: &Tensor, weights: &Tensor, bias: &Tensor, shape: Convolution) -> Result<Tensor> {
    x.apply_op3(weights, bias, ConvolutionOp(shape))
}

/// Returns the means of 2x2 pixels of images; `x [N H W, C]`.
pub(super) fn downsample(x: &Tensor, shape: Resize) -> Result<Tensor> {
    x.apply_op1(ResizeOp { shape, upsamples: false })
}

/// Returns images at twice the size, H x W, by bilinear interpolation.
pub(super) fn upsample(x: &Tensor, shape: Resize) -> Result<Tensor> {
    x.apply_op1(ResizeOp { shape, upsamples: true })
}

struct ConvolutionOp(Convolution);

impl CustomOp3 for ConvolutionOp {
    fn name(&self) -> &'static str {
        "convolution"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        weights: &CpuStorage,
        weights_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let rows = x_layout.shape().dims2()?.0;
        let (x, weights, bias) =
            (slice(x, x_layout)?, slice(weights, weights_layout)?, slice(bias, bias_layout)?);
        Ok((CpuStorage::F32(self.0.forward(x, weights, bias)), Shape::from((rows, self.0.outputs))))
    }

    fn bwd(
        &self,
        x: &Tensor,
        weights: &Tensor,
        bias: &Tensor,
        out: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        // The first convolution has inputs that are not trained.
        let x_grad = match x.track_op() {
            true => Some(like(x, lend(&[weights, out, grad], |t| self.0.input_grad(t[0], t[1], t[2]))?)?),
            false => None,
        };
        let (weights_grad, bias_grad) = lend(&[x, out, grad], |t| self.0.weights_grad(t[0], t[1], t[2]))?;
        Ok((x_grad, Some(like(weights, weights_grad)?), Some(like(bias, bias_grad)?)))
    }
}

/// Halves images, or doubles them.
struct ResizeOp {
    shape: Resize,
    upsamples: bool,
}

impl CustomOp1 for ResizeOp {
    fn name(&self) -> &'static str {
        "resize"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let (Self { shape, upsamples }, x) = (self, slice(x, layout)?);
        let out = if *upsamples { shape.upsample(x) } else { shape.downsample(x) };
        let rows = out.len() / shape.channels;
        Ok((CpuStorage::F32(out), Shape::from((rows, shape.channels))))
    }

    fn bwd(&self, x: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let Self { shape, upsamples } = self;
        let of = |grad: &[f32]| {
            if *upsamples { shape.upsample_backward(grad) } else { shape.downsample_backward(grad) }
        };
        like(x, lend(&[grad], |t| of(t[0]))?).map(Some)
    }
}

struct MixOp(AttentionMlp);

impl CustomOp1 for MixOp {
    fn name(&self) -> &'static str {
        "mix"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let out = self.0.forward(slice(storage, layout)?);
        Ok((CpuStorage::F32(out), Shape::from((self.0.grid.rows(), self.0.width + self.0.hidden))))
    }

    fn bwd(&self, rows: &Tensor, _: &Tensor, grad: &Tensor) -> Result<Option<Tensor>> {
        let out = lend(&[rows, grad], |t| self.0.backward(t[0], t[1]))?;
        like(rows, out).map(Some)
    }
}

struct NormOp;

impl CustomOp2 for NormOp {
    fn name(&self) -> &'static str {
        "norm-modulate"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        m: &CpuStorage,
        m_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let d = x_layout.shape().dims2()?.1;
        let out = kernels::norm_forward(slice(x, x_layout)?, slice(m, m_layout)?, d);
        Ok((CpuStorage::F32(out), x_layout.shape().clone()))
    }

    fn bwd(
        &self,
        x: &Tensor,
        modulation: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let d = x.dims2()?.1;
        let (x_grad, modulation_grad) =
            lend(&[x, modulation, grad], |t| kernels::norm_backward(t[0], t[1], t[2], d))?;
        Ok((Some(like(x, x_grad)?), Some(like(modulation, modulation_grad)?)))
    }
}

struct GateOp;

impl CustomOp3 for GateOp {
    fn name(&self) -> &'static str {
        "gated-add"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        y: &CpuStorage,
        y_layout: &Layout,
        gate: &CpuStorage,
        gate_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let d = x_layout.shape().dims2()?.1;
        let (x, y, gate) = (slice(x, x_layout)?, slice(y, y_layout)?, slice(gate, gate_layout)?);
        Ok((CpuStorage::F32(kernels::gate_forward(x, y, gate, d)), x_layout.shape().clone()))
    }

    fn bwd(
        &self,
        _: &Tensor,
        y: &Tensor,
        gate: &Tensor,
        _: &Tensor,
        grad: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let d = y.dims2()?.1;
        let (y_grad, gate_grad) = lend(&[y, gate, grad], |t| kernels::gate_backward(t[0], t[1], t[2], d))?;
        Ok((Some(grad.clone()), Some(like(y, y_grad)?), Some(like(gate, gate_grad)?)))
    }
}
