//! Layers with their gradients, written for one CPU core.
//!
//! Layers and optimiser are our own, behind candle's traits. Matrix products are candle's; the operations between them are
//! fused here, and made of candle's operations on other devices. candle's fused layer norm and softmax drop the gradient
//! without an error, and its unfused ones cost more than the products. Results have the same bits with and without gradients (tested). Every operation works in `f32` and, for checks
//! against finite differences, in `f64`.

mod adamw;
mod add_row;
mod batch_norm;
mod composed;
mod groups;
mod gru;
mod layers;
mod lstm;
mod maxima;
mod norm_relu;
mod real;
mod sequences;
mod softmax;

pub use adamw::{AdamW, AdamWConfig, Moments};
pub use add_row::{add_row, column_sums};
pub use batch_norm::{BatchNorm, is_running, is_running_variance};
#[doc(hidden)]
pub use composed::compose_on_cpu;
pub use groups::{Group, Groups};
pub use gru::Gru;
pub use layers::{Attention, Linear, Mlp, ResCat};
pub use lstm::Lstm;
pub use maxima::{max_of_others, max_of_rows};
pub use norm_relu::norm_relu;
pub use real::{BlockSums, Real, by_dtype, sigmoid, slice, slice_mut, tanh, wide, with_slice};
pub use sequences::Sequences;
pub use softmax::{log_softmax, softmax};
