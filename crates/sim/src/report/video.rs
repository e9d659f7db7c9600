//! `rollout.mp4`: images of one size as H.264 in an MP4 file.
//!
//! # How it works
//! OpenH264 encodes on one thread with a constant quantizer, so the same images give the same bytes. Its byte
//! stream (NAL units after start codes, ITU-T H.264 Annex B) is converted to the MP4 form: lengths instead of
//! start codes, and the parameter sets apart from the samples (ISO/IEC 14496-15).

use std::io::Cursor;
use std::path::{Path, PathBuf};

use mp4::{AvcConfig, Bytes, MediaConfig, Mp4Config, Mp4Sample, Mp4Writer, TrackConfig, TrackType};
use openh264::OpenH264API;
use openh264::encoder::{Encoder, EncoderConfig, IntraFramePeriod, RateControlMode, VuiConfig};
use openh264::formats::{RgbSliceU8, YUVBuffer};
use point_skeleton::error::FileError;
use point_skeleton::files::write_whole;
use point_skeleton::geometry::ImageSize;

/// Clock ticks per second in the file.
const TICKS_HZ: u32 = 90_000;
/// Key-frame interval, frames; players can seek to key frames.
const KEY_PERIOD: u32 = 20;
/// Maximum side of a frame, pixels; a limit of the encoder.
pub const MAX_SIDE_PX: u32 = 2160;

/// Error of writing a video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// Error of the file.
    #[error(transparent)]
    File(#[from] FileError),
    /// A size that cannot be encoded, or that differs from the first one.
    #[error("expected pictures of one even size up to {MAX_SIDE_PX}x{MAX_SIDE_PX} pixels, found {found}: \
        {}", path.display())]
    Size {
        /// The rejected size.
        found: ImageSize,
        /// Path of the video.
        path: PathBuf,
    },
    /// Error of the encoder.
    #[error("cannot encode the video: {source}: {}", path.display())]
    Encoder {
        /// Underlying error.
        source: openh264::Error,
        /// Path of the video.
        path: PathBuf,
    },
    /// Error of the MP4 writer.
    #[error("cannot write the video: {source}: {}", path.display())]
    Container {
        /// Underlying error.
        source: mp4::Error,
        /// Path of the video.
        path: PathBuf,
    },
}

/// A video being encoded; in memory until [`Video::write`].
pub struct Video {
    encoder: Encoder,
    size: ImageSize,
    /// Duration of a frame, ticks.
    duration: u32,
    samples: Vec<Sample>,
    /// Sequence and picture parameter sets.
    sps: Vec<u8>,
    pps: Vec<u8>,
    path: PathBuf,
}

/// An encoded frame in MP4 form.
struct Sample {
    bytes: Vec<u8>,
    is_key: bool,
}

impl Video {
    /// Starts a video with frames of one size, `rate_hz` per second, that will be written to `path`.
    ///
    /// # Errors
    /// Returns an error if a side is odd, below 16 or above [`MAX_SIDE_PX`], or if the encoder cannot be
    /// created.
    pub fn new(path: &Path, size: ImageSize, rate_hz: f64) -> Result<Self, VideoError> {
        Self::check(path, size)?;
        let config = EncoderConfig::new()
            .rate_control_mode(RateControlMode::Off)
            .skip_frames(false)
            .num_threads(1)
            .intra_frame_period(IntraFramePeriod::from_num_frames(KEY_PERIOD))
            .vui(VuiConfig::bt601());
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|source| VideoError::Encoder { source, path: path.to_owned() })?;
        let duration = (f64::from(TICKS_HZ) / rate_hz).round().clamp(1.0, f64::from(u32::MAX)) as u32;
        let (samples, sps, pps) = Default::default();
        Ok(Self { encoder, size, duration, samples, sps, pps, path: path.to_owned() })
    }

    /// Checks that images of a size can be encoded.
    ///
    /// # Errors
    /// Returns an error if a side is odd, below 16 or above [`MAX_SIDE_PX`].
    pub fn check(path: &Path, size: ImageSize) -> Result<(), VideoError> {
        let fits = |side: u32| side.is_multiple_of(2) && (16..=MAX_SIDE_PX).contains(&side);
        if fits(size.height) && fits(size.width) {
            return Ok(());
        }
        Err(VideoError::Size { found: size, path: path.to_owned() })
    }

    /// Encodes a frame, RGB row by row.
    ///
    /// # Errors
    /// Returns an error if the frame has another size, or if the encoder fails.
    pub fn push(&mut self, size: ImageSize, pixels: &[[u8; 3]]) -> Result<(), VideoError> {
        if size != self.size || pixels.len() != size.pixels() {
            return Err(VideoError::Size { found: size, path: self.path.clone() });
        }
        let rgb = RgbSliceU8::new(pixels.as_flattened(), (size.width as usize, size.height as usize));
        let yuv = YUVBuffer::from_rgb8_source(rgb);
        let failed = |source| VideoError::Encoder { source, path: self.path.clone() };
        let stream = self.encoder.encode(&yuv).map_err(failed)?;
        let mut sample = Sample { bytes: Vec::new(), is_key: false };
        let layers = (0..stream.num_layers()).filter_map(|i| stream.layer(i));
        for unit in layers.flat_map(|layer| {
            (0..layer.nal_count()).filter_map(|i| layer.nal_unit(i).map(<[u8]>::to_vec)).collect::<Vec<_>>()
        }) {
            let unit = without_start_code(&unit);
            // The lower five bits of the first byte are the type: 7 and 8 are parameter sets, 5 is a key
            // frame.
            match unit.first().map(|header| header & 31) {
                Some(7) => self.sps = unit.to_vec(),
                Some(8) => self.pps = unit.to_vec(),
                Some(kind) => {
                    sample.is_key |= kind == 5;
                    sample.bytes.extend((unit.len() as u32).to_be_bytes());
                    sample.bytes.extend(unit);
                }
                None => {}
            }
        }
        self.samples.push(sample);
        Ok(())
    }

    /// Writes the file; writes nothing if there are no frames.
    ///
    /// # Errors
    /// Fails if the MP4 data cannot be assembled, or if the file cannot be written.
    pub fn write(self) -> Result<(), VideoError> {
        let path = self.path.clone();
        let Some(bytes) = self.into_bytes()? else { return Ok(()) };
        write_whole(&path, |out| {
            std::io::Write::write_all(out, &bytes).map_err(FileError::io("write", &path))
        })
        .map_err(|error: FileError| error.into())
    }

    /// Returns the bytes of the file; `None` if there are no frames.
    ///
    /// # Errors
    /// Fails if the MP4 data cannot be assembled.
    pub fn into_bytes(self) -> Result<Option<Vec<u8>>, VideoError> {
        // A parameter set begins with a header, and three bytes of profile and level.
        if self.samples.is_empty() || self.sps.len() < 4 || self.pps.is_empty() {
            return Ok(None);
        }
        let path = self.path.clone();
        self.container().map(Some).map_err(|source| VideoError::Container { source, path })
    }

    /// Returns the bytes of the file, assembled in memory because sizes are known last.
    fn container(self) -> mp4::Result<Vec<u8>> {
        let brands = [*b"isom", *b"iso2", *b"avc1", *b"mp41"];
        let config = Mp4Config {
            major_brand: brands[0].into(),
            minor_version: 512,
            compatible_brands: brands.into_iter().map(Into::into).collect(),
            timescale: TICKS_HZ,
        };
        let mut writer = Mp4Writer::write_start(Cursor::new(Vec::new()), &config)?;
        // The sides are at most `MAX_SIDE_PX`, so the casts are lossless.
        let avc = AvcConfig {
            width: self.size.width as u16,
            height: self.size.height as u16,
            seq_param_set: self.sps,
            pic_param_set: self.pps,
        };
        writer.add_track(&TrackConfig {
            track_type: TrackType::Video,
            timescale: TICKS_HZ,
            language: "und".to_owned(),
            media_conf: MediaConfig::AvcConfig(avc),
        })?;
        for (number, sample) in (0_u64..).zip(self.samples) {
            writer.write_sample(
                1,
                &Mp4Sample {
                    start_time: number * u64::from(self.duration),
                    duration: self.duration,
                    rendering_offset: 0,
                    is_sync: sample.is_key,
                    bytes: Bytes::from(sample.bytes),
                },
            )?;
        }
        writer.write_end()?;
        Ok(writer.into_writer().into_inner())
    }
}

/// Removes the start code `00 00 01` or `00 00 00 01`.
fn without_start_code(unit: &[u8]) -> &[u8] {
    let zeros = unit.iter().take_while(|byte| **byte == 0).count();
    if zeros >= 2 && unit.get(zeros) == Some(&1) { &unit[zeros + 1..] } else { unit }
}

#[cfg(test)]
mod tests {
    use openh264::decoder::Decoder;
    use openh264::formats::YUVSource;

    use super::*;

    const SIZE: ImageSize = ImageSize { height: 48, width: 64 };

    /// Returns a uniform gray image, brighter with each number.
    fn picture(number: usize) -> Vec<[u8; 3]> {
        vec![[40 + 5 * number as u8; 3]; SIZE.pixels()]
    }

    fn written(count: usize) -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.mp4");
        let mut video = Video::new(&path, SIZE, 12.0).unwrap();
        (0..count).for_each(|i| video.push(SIZE, &picture(i)).unwrap());
        video.write().unwrap();
        std::fs::read(&path).unwrap_or_default()
    }

    #[test]
    fn video_round_trips() {
        let bytes = written(25);
        assert_eq!(bytes, written(25));
        let size = bytes.len() as u64;
        let mut reader = mp4::Mp4Reader::read_header(Cursor::new(bytes), size).unwrap();
        let track = &reader.tracks()[&1];
        assert_eq!((track.width(), track.height(), track.sample_count()), (64, 48, 25));
        assert!((track.frame_rate() - 12.0).abs() < 0.01, "{}", track.frame_rate());
        let mut decoder = Decoder::new().unwrap();
        let start = [0, 0, 0, 1];
        let mut sets = Vec::new();
        for set in [track.sequence_parameter_set().unwrap(), track.picture_parameter_set().unwrap()] {
            sets.extend(start.iter().chain(set));
        }
        decoder.decode(&sets).unwrap();
        for number in 0..25_usize {
            let sample = reader.read_sample(1, number as u32 + 1).unwrap().unwrap();
            assert_eq!(sample.is_sync, number.is_multiple_of(20), "{number}");
            assert_eq!(sample.start_time, 7500 * number as u64);
            // Each frame is one NAL unit: a length, then its bytes.
            let length = u32::from_be_bytes(sample.bytes[..4].try_into().unwrap()) as usize;
            assert_eq!(length + 4, sample.bytes.len());
            let unit: Vec<u8> = start.iter().chain(&sample.bytes[4..]).copied().collect();
            let decoded = decoder.decode(&unit).unwrap().unwrap();
            // BT.601: gray v is luma 16 + v * 219 / 255.
            let expected = 16.0 + f64::from(picture(number)[0][0]) * 219.0 / 255.0;
            let luma = f64::from(decoded.y()[decoded.strides().0 * 24 + 32]);
            assert!((luma - expected).abs() < 3.0, "{number}: {luma}, expected {expected}");
        }
    }

    #[test]
    fn rejects_wrong_sizes_and_writes_no_empty_video() {
        assert_eq!(written(0), [0; 0]);
        let new = |height, width| Video::new(Path::new("v.mp4"), ImageSize { height, width }, 10.0);
        for (height, width) in [(47, 64), (48, 0), (4000, 64)] {
            let message = new(height, width).err().unwrap().to_string();
            assert!(message.ends_with(&format!("found {height}x{width}: v.mp4")), "{message}");
        }
        let other = ImageSize { height: 64, width: 48 };
        assert!(new(48, 64).unwrap().push(other, &picture(0)).is_err());
    }

    #[test]
    fn write_error_names_the_file() {
        let mut video = Video::new(Path::new("/proc/none.mp4"), SIZE, 10.0).unwrap();
        video.push(SIZE, &picture(0)).unwrap();
        assert!(video.write().unwrap_err().to_string().ends_with("/proc/none.mp4"));
    }
}
