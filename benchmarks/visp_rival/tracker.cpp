// ViSP's model-based tracker over a list of frames: one tracker for each object, each blind to the others.
//
//   tracker LIST OUT.csv edge|scanline|both [feed]
//
// LIST is written by compare.py: "camera fx fy cx cy", then "object ID MODEL.cao" with the 16 numbers
// of camera_from_object in the first frame, then "frame NUMBER IMAGE.pgm" with those of
// camera_from_world. "scanline" has each object's own faces hide one another by scan lines; "both" tracks
// edges and points (KLT). With "feed" each pose is moved by the camera's motion before a frame is tracked.
// A tracker that fails reports no pose in that frame, and begins anew where it was. At the end the
// processor's time of a frame is printed, in milliseconds, without that of reading it.

#include <ctime>
#include <fstream>
#include <iomanip>
#include <iostream>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpException.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpImage.h>
#include <visp3/io/vpImageIo.h>
#include <visp3/mbt/vpMbGenericTracker.h>

namespace {

struct Object {
  int id;
  std::string model;
  vpHomogeneousMatrix pose;
  std::unique_ptr<vpMbGenericTracker> tracker;
};

struct Frame {
  int number;
  std::string image;
  vpHomogeneousMatrix camera;
};

vpHomogeneousMatrix readPose(std::istream &in)
{
  vpHomogeneousMatrix pose;
  for (unsigned int row = 0; row < 4; row++) {
    for (unsigned int column = 0; column < 4; column++) {
      in >> pose[row][column];
    }
  }
  return pose;
}

std::unique_ptr<vpMbGenericTracker> makeTracker(const std::string &how, const vpCameraParameters &lens)
{
  const int edges = vpMbGenericTracker::EDGE_TRACKER;
  const bool points = how == "both";
  auto tracker = std::make_unique<vpMbGenericTracker>(1, points ? edges | vpMbGenericTracker::KLT_TRACKER : edges);
  vpMe search;
  search.setMaskSize(5);
  search.setMaskNumber(180);
  search.setRange(8);
  search.setThreshold(10000);
  search.setMu1(0.5);
  search.setMu2(0.5);
  search.setSampleStep(4);
  tracker->setMovingEdge(search);
  if (points) {
    vpKltOpencv klt;
    klt.setMaxFeatures(10000);
    klt.setWindowSize(5);
    klt.setQuality(0.01);
    klt.setMinDistance(5);
    klt.setHarrisFreeParameter(0.02);
    klt.setBlockSize(3);
    klt.setPyramidLevels(3);
    tracker->setKltOpencv(klt);
    tracker->setKltMaskBorder(5);
  }
  tracker->setAngleAppear(vpMath::rad(85));
  tracker->setAngleDisappear(vpMath::rad(89));
  tracker->setNearClippingDistance(0.01);
  tracker->setFarClippingDistance(5.0);
  tracker->setClipping(tracker->getClipping() | vpMbtPolygon::FOV_CLIPPING);
  tracker->setCameraParameters(lens);
  tracker->setScanLineVisibilityTest(how == "scanline");
  tracker->setDisplayFeatures(false);
  return tracker;
}

void write(std::ostream &out, int frame, int object, const vpHomogeneousMatrix &pose)
{
  out << "1," << frame << "," << object << ",1,";
  for (unsigned int row = 0; row < 3; row++) {
    for (unsigned int column = 0; column < 3; column++) {
      out << (row + column ? " " : "") << pose[row][column];
    }
  }
  out << "," << 1000 * pose[0][3] << " " << 1000 * pose[1][3] << " " << 1000 * pose[2][3] << ",-1\n";
}

} // namespace

int main(int count, char **arguments)
{
  if (count < 4) {
    std::cerr << "usage: tracker LIST OUT.csv edge|scanline|both [feed]" << std::endl;
    return 2;
  }
  const std::string how = arguments[3];
  const bool feed = count > 4 && std::string(arguments[4]) == "feed";
  std::ifstream list(arguments[1]);
  std::ofstream out(arguments[2]);
  out << std::setprecision(12) << "scene_id,im_id,obj_id,score,R,t,time\n";
  vpCameraParameters lens;
  std::vector<Object> objects;
  std::vector<Frame> frames;
  for (std::string kind; list >> kind;) {
    if (kind == "camera") {
      double fx, fy, cx, cy;
      list >> fx >> fy >> cx >> cy;
      lens.initPersProjWithoutDistortion(fx, fy, cx, cy);
    } else if (kind == "object") {
      Object object;
      list >> object.id >> object.model;
      object.pose = readPose(list);
      objects.push_back(std::move(object));
    } else {
      Frame frame;
      list >> frame.number >> frame.image;
      frame.camera = readPose(list);
      frames.push_back(frame);
    }
  }
  if (!list.eof() || objects.empty() || frames.empty() || !out) {
    std::cerr << "error: " << arguments[1] << " cannot be read, or " << arguments[2] << " not written" << std::endl;
    return 1;
  }
  double spent_ms = 0.0;
  for (size_t at = 0; at < frames.size(); at++) {
    vpImage<unsigned char> image;
    vpImageIo::read(image, frames[at].image);
    const std::clock_t begun = std::clock();
    for (Object &object : objects) {
      bool right = false;
      try {
        if (!object.tracker) {
          object.tracker = makeTracker(how, lens);
          object.tracker->loadModel(object.model);
          object.tracker->initFromPose(image, object.pose);
        } else if (feed) {
          object.pose = frames[at].camera * frames[at - 1].camera.inverse() * object.pose;
          object.tracker->setPose(image, object.pose);
        }
        object.tracker->track(image);
        object.tracker->getPose(object.pose);
        right = true;
      } catch (const vpException &) {
        object.tracker.reset();
      }
      if (right) {
        write(out, frames[at].number, object.id, object.pose);
      }
    }
    spent_ms += 1000.0 * (std::clock() - begun) / CLOCKS_PER_SEC;
  }
  std::cout << spent_ms / frames.size() << std::endl;
  return 0;
}
