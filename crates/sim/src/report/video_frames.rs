//! Reads the frames of videos: H.264 in MP4 files.

use std::collections::VecDeque;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use image::RgbImage;
use mp4::{MediaType, Mp4Reader, TrackType};
use openh264::OpenH264API;
use openh264::decoder::{DecodedYUV, Decoder, DecoderConfig, Flush};
use openh264::formats::YUVSource;
use point_skeleton::error::FileError;
use point_skeleton::geometry::ImageSize;

/// Start code of a NAL unit.
const START: [u8; 4] = [0, 0, 0, 1];

/// What is read.
const EXPECTED: &str = "a video of H.264 in an MP4 file (ffmpeg -i IN -c:v libx264 -pix_fmt yuv420p OUT.mp4)";

/// Frames of a video, in the order in which they are shown.
pub struct VideoFrames {
    path: PathBuf,
    reader: Mp4Reader<BufReader<File>>,
    track: u32,
    size: ImageSize,
    count: usize,
    /// Bytes of the length before each NAL unit.
    length_bytes: usize,
    decoder: Decoder,
    /// Number of the next sample to decode, from 1.
    sample: u32,
    /// Number of the frame at the front of `ready`.
    next: usize,
    /// Decoded frames.
    ready: VecDeque<RgbImage>,
}

impl VideoFrames {
    /// Opens a video and reads its index.
    ///
    /// # Errors
    /// Fails if the file cannot be read, or is not H.264 in an MP4 file.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let file = File::open(path).map_err(FileError::io("read", path))?;
        let bytes = file.metadata().map_err(FileError::io("read", path))?.len();
        let other = |found: String| FileError::content(EXPECTED, found, path);
        let reader = Mp4Reader::read_header(BufReader::new(file), bytes)
            .map_err(|error| other(format!("another file ({error})")))?;
        let mut videos: Vec<_> = reader
            .tracks()
            .iter()
            .filter(|(_, track)| track.track_type().is_ok_and(|kind| kind == TrackType::Video))
            .collect();
        videos.sort_by_key(|(number, _)| **number);
        let (number, track) = videos.first().ok_or_else(|| other("a file without video".to_owned()))?;
        match track.media_type() {
            Ok(MediaType::H264) => {}
            Ok(codec) => return Err(other(format!("{codec} video"))),
            Err(_) => return Err(other("video of another codec".to_owned())),
        }
        let sets = [track.sequence_parameter_set(), track.picture_parameter_set()];
        let [Ok(sequence), Ok(picture)] = sets else {
            return Err(other("one without parameter sets".to_owned()));
        };
        let header: Vec<u8> =
            [sequence, picture].into_iter().flat_map(|set| START.iter().chain(set)).copied().collect();
        let avc = track.trak.mdia.minf.stbl.stsd.avc1.as_ref();
        let length_bytes = avc.map_or(4, |avc| usize::from(avc.avcc.length_size_minus_one & 3) + 1);
        let size = ImageSize { height: u32::from(track.height()), width: u32::from(track.width()) };
        let (number, count) = (**number, track.sample_count() as usize);
        let config = DecoderConfig::new().flush_after_decode(Flush::NoFlush);
        let decoder = Decoder::with_api_config(OpenH264API::from_source(), config);
        let mut video = Self {
            path: path.to_owned(),
            reader,
            track: number,
            size,
            count,
            length_bytes,
            decoder: decoder.map_err(|error| FileError::io("decode", path)(std::io::Error::other(error)))?,
            sample: 1,
            next: 0,
            ready: VecDeque::new(),
        };
        video.decode(&header)?;
        Ok(video)
    }

    /// Size of the frames.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Number of frames.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Returns whether this video has this path, and the frame `number` was not passed.
    pub fn is_before(&self, path: &Path, number: usize) -> bool {
        self.path == path && self.next <= number
    }

    /// Returns a frame by its number from 0. Earlier frames are then passed.
    ///
    /// # Errors
    /// Fails if the file is damaged, or if the frame was passed or is after the end.
    pub fn frame(&mut self, number: usize) -> Result<RgbImage, FileError> {
        loop {
            while let Some(image) = self.ready.pop_front() {
                self.next += 1;
                if self.next == number + 1 {
                    return Ok(image);
                }
            }
            if self.next > number || !self.advance()? {
                let found = format!("{} frames", self.next);
                return Err(FileError::content(
                    format!("frame {number} of {}", self.count),
                    found,
                    &self.path,
                ));
            }
        }
    }

    /// Decodes the next sample, or what is left after the last one; `false` after the end.
    fn advance(&mut self) -> Result<bool, FileError> {
        if self.sample as usize > self.count {
            let left = self.decoder.flush_remaining().map_err(|error| failed(&self.path, &error))?;
            let before = self.ready.len();
            self.ready.extend(left.iter().map(rgb));
            return Ok(self.ready.len() > before);
        }
        let read = self.reader.read_sample(self.track, self.sample);
        let damaged = |found: String| FileError::content("a sample of the video", found, &self.path);
        let sample = read.map_err(|error| damaged(error.to_string()))?;
        let sample = sample.ok_or_else(|| damaged(format!("none at number {}", self.sample)))?;
        let units =
            units(&sample.bytes, self.length_bytes).ok_or_else(|| damaged("a damaged one".to_owned()))?;
        let stream: Vec<u8> = units.into_iter().flat_map(|unit| START.iter().chain(unit)).copied().collect();
        self.sample += 1;
        self.decode(&stream)?;
        Ok(true)
    }

    fn decode(&mut self, stream: &[u8]) -> Result<(), FileError> {
        let decoded = self.decoder.decode(stream).map_err(|error| failed(&self.path, &error))?;
        let image = decoded.as_ref().map(rgb);
        if let Some(other) =
            image.as_ref().filter(|image| image.dimensions() != (self.size.width, self.size.height))
        {
            let found = format!("{}x{}", other.height(), other.width());
            return Err(FileError::content(format!("frames of {}", self.size), found, &self.path));
        }
        self.ready.extend(image);
        Ok(())
    }
}

fn failed(path: &Path, error: &openh264::Error) -> FileError {
    FileError::content(EXPECTED, format!("one that cannot be decoded ({error})"), path)
}

/// Converts a frame, by BT.601 with limited range.
fn rgb(frame: &DecodedYUV<'_>) -> RgbImage {
    let (width, height) = frame.dimensions();
    let mut image = RgbImage::new(width as u32, height as u32);
    frame.write_rgb8(&mut image);
    image
}

/// Splits a sample into NAL units, each after its length; `None` if a length exceeds the sample.
fn units(mut bytes: &[u8], length_bytes: usize) -> Option<Vec<&[u8]>> {
    let mut units = Vec::new();
    while !bytes.is_empty() {
        let (length, rest) = bytes.split_at_checked(length_bytes)?;
        let length = length.iter().fold(0_usize, |length, byte| length << 8 | usize::from(*byte));
        let (unit, rest) = rest.split_at_checked(length)?;
        units.push(unit);
        bytes = rest;
    }
    Some(units)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Video;

    const SIZE: ImageSize = ImageSize { height: 48, width: 64 };

    /// Levels are so far apart that the loss of the encoder cannot make one frame look like another.
    fn level(number: usize) -> u8 {
        20 + 9 * number as u8
    }

    #[test]
    fn frames_are_those_of_the_video() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.mp4");
        let mut video = Video::new(&path, SIZE, 12.0).unwrap();
        (0..25).for_each(|number| video.push(SIZE, &vec![[level(number); 3]; SIZE.pixels()]).unwrap());
        video.write().unwrap();
        let mut frames = VideoFrames::open(&path).unwrap();
        assert_eq!((frames.size(), frames.count()), (SIZE, 25));
        for number in [0, 1, 2, 7, 24] {
            assert!(frames.is_before(&path, number) && !frames.is_before(Path::new("w.mp4"), number));
            let image = frames.frame(number).unwrap();
            let off = image.iter().map(|found| found.abs_diff(level(number))).max();
            assert!(off <= Some(4), "{number}: {off:?}");
        }
        assert!(!frames.is_before(&path, 24));
        let error = frames.frame(24).unwrap_err().to_string();
        assert!(error.contains("frame 24 of 25, found 25 frames") && error.ends_with("v.mp4"), "{error}");
        // Truncated, and no video.
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        assert!(VideoFrames::open(&path).and_then(|mut frames| frames.frame(24)).is_err());
        std::fs::write(&path, "no video").unwrap();
        let error = VideoFrames::open(&path).err().unwrap().to_string();
        assert!(error.starts_with("expected a video of H.264"), "{error}");
    }

    #[test]
    fn samples_are_split_into_units() {
        assert_eq!(units(&[0, 2, 7, 8, 0, 1, 9], 2), Some(vec![&[7, 8][..], &[9]]));
        assert_eq!([units(&[0, 2, 7], 2), units(&[0], 2)], [None, None]);
    }
}
